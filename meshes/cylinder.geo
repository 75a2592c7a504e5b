// Cylinder about the x axis, 0 <= x <= length, with about `cells` cells along its diameter and cells
// of the same size along its length: hexahedra (tets = 0) or tetrahedra (tets = 1).
//
// The hexahedra of a cross-section form an O-grid of about 0.84 cells^2: a core of n x n cells with
// rounded sides, n = 3/5 cells, and four blocks of n x (cells - n)/2 around it. Six tetrahedra
// replace each hexahedron. order = 2 gives cells with curved faces.
//
// With plane = 1 it is the rectangle 0 <= x <= radius, 0 <= y <= length, which revolves about the y axis:
// quadrilaterals or triangles, half of `cells` along the radius.
//
// Meshes like that of Smith et al. 2018, which has 306,000 hexahedra and 965,000 degrees of freedom:
//   length = 2 radius   cells = 71   302,247 hexahedra   938,304 degrees of freedom
//   length = 4 radius   cells = 56   297,024             922,419   (57: 315,210 and 978,420)
//   length = 6 radius   cells = 50   315,000             978,933
//   length = 8 radius   cells = 45   306,180             953,508
SetFactory("Built-in");
DefineConstant[
  cells = {15, Min 3, Step 1, Name "cells"}
  radius = {0.5, Name "radius"}
  length = {1, Name "length"}
  tets = {0, Choices{0, 1}, Name "tets"}
  order = {1, Choices{1, 2}, Name "order"}
  plane = {0, Choices{0, 1}, Name "plane"}
];
If (!(cells >= 3) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 3 or more", cells);
EndIf
If (!(radius > 0) || !(length > 0))
  Error("radius = %g, length = %g: expected positive numbers", radius, length);
EndIf

If (order != 1 && order != 2)
  Error("order = %g: expected 1 or 2", order);
EndIf

layers = Floor(cells * length / (2 * radius) + 0.5);
layers = layers < 1 ? 1 : layers;

If (plane)
  Point(1) = {0, 0, 0}; Point(2) = {radius, 0, 0}; Point(3) = {radius, length, 0}; Point(4) = {0, length, 0};
  Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
  Curve Loop(1) = {1, 2, 3, 4};
  Plane Surface(1) = {1};
  Transfinite Curve {1, 3} = Floor(cells / 2 + 0.5) + 1;
  Transfinite Curve {2, 4} = layers + 1;
  If (tets)
    Transfinite Surface {1} Alternate;
  Else
    Transfinite Surface {1};
    Recombine Surface {1};
  EndIf
  Physical Surface("body") = {1};
  Physical Curve("left") = {1};
  Physical Curve("right") = {3};
  Physical Curve("side") = {2};
Else
ring = Floor(cells / 5 + 0.5);
ring = ring < 1 ? 1 : ring;
core = cells - 2 * ring;

// The core's shape maximises the smallest angle (at least 58 degrees) at even edge lengths. Its corners
// are at (k, k), the midpoints of its sides at distance m, on arcs with centres at distance c beyond
// the axis.
share = core / cells;
share = share < 0.5 ? 0.5 : share;
k = 0.80 * share * radius;
m = 0.91 * share * radius;
c = (2 * k^2 - m^2) / (2 * (m - k));

Point(1) = {0, 0, 0};
out = radius / Sqrt(2);
Point(2) = {0, out, -out}; Point(3) = {0, out, out}; Point(4) = {0, -out, out}; Point(5) = {0, -out, -out};
Circle(1) = {2, 1, 3}; Circle(2) = {3, 1, 4}; Circle(3) = {4, 1, 5}; Circle(4) = {5, 1, 2};

Point(6) = {0, k, -k}; Point(7) = {0, k, k}; Point(8) = {0, -k, k}; Point(9) = {0, -k, -k};
Point(10) = {0, -c, 0}; Point(11) = {0, 0, -c}; Point(12) = {0, c, 0}; Point(13) = {0, 0, c};
Circle(5) = {6, 10, 7}; Circle(6) = {7, 11, 8}; Circle(7) = {8, 12, 9}; Circle(8) = {9, 13, 6};
Line(9) = {6, 2}; Line(10) = {7, 3}; Line(11) = {8, 4}; Line(12) = {9, 5};

Curve Loop(1) = {5, 6, 7, 8};
Curve Loop(2) = {9, 1, -10, -5};
Curve Loop(3) = {10, 2, -11, -6};
Curve Loop(4) = {11, 3, -12, -7};
Curve Loop(5) = {12, 4, -9, -8};
Plane Surface(1) = {1}; Plane Surface(2) = {2}; Plane Surface(3) = {3};
Plane Surface(4) = {4}; Plane Surface(5) = {5};

Transfinite Curve {1:8} = core + 1;
Transfinite Curve {9:12} = ring + 1;
If (tets)
  Transfinite Surface {1:5} Alternate;
Else
  Transfinite Surface {1:5};
  Recombine Surface {1:5};
EndIf

// Extrude returns the opposite surface, the volume, and the side surfaces in the order of the curves.
right[] = {}; body[] = {}; side[] = {};
For i In {1:5}
  If (tets)
    block[] = Extrude {length, 0, 0} { Surface{i}; Layers{layers}; };
  Else
    block[] = Extrude {length, 0, 0} { Surface{i}; Layers{layers}; Recombine; };
  EndIf
  right[] += block[0];
  body[] += block[1];
  If (i > 1)
    side[] += block[3];
  EndIf
EndFor

Physical Volume("body") = {body[]};
Physical Surface("left") = {1:5};
Physical Surface("right") = {right[]};
Physical Surface("side") = {side[]};
EndIf

Mesh.ElementOrder = order;
