// One octant of a spherical shell about the origin, x, y, z >= 0: three blocks of hexahedra (tets = 0)
// or tetrahedra (tets = 1), with `cells` cells along a quarter circle and `layers` across the wall.
// order = 2 gives cells with curved faces.
SetFactory("Built-in");
DefineConstant[
  cells = {8, Min 2, Step 2, Name "cells"}
  layers = {2, Min 1, Step 1, Name "layers"}
  inner = {1, Name "inner"}
  outer = {1.5, Name "outer"}
  tets = {0, Choices{0, 1}, Name "tets"}
  order = {2, Choices{1, 2}, Name "order"}
];
If (!(cells >= 2) || cells != 2 * Floor(cells / 2))
  Error("cells = %g: expected an even number, 2 or more", cells);
EndIf
If (!(layers >= 1) || layers != Floor(layers))
  Error("layers = %g: expected a whole number, 1 or more", layers);
EndIf
If (!(inner > 0) || !(outer > inner))
  Error("inner = %g, outer = %g: expected 0 < inner < outer", inner, outer);
EndIf
If (order != 1 && order != 2)
  Error("order = %g: expected 1 or 2", order);
EndIf

// Points, arcs and faces of the inner sphere (s = 0) and of the outer one (s = 1). Points 1, 2, 3 are
// on the axes, 4, 5, 6 between them, 7 in the middle; arcs 1 to 6 go round the edge, 7 to 9 inwards.
Point(100) = {0, 0, 0};
half = 1 / Sqrt(2);
middle = 1 / Sqrt(3);
For s In {0:1}
  r = s ? outer : inner;
  p = 10 * s;
  Point(p + 1) = {r, 0, 0}; Point(p + 2) = {0, r, 0}; Point(p + 3) = {0, 0, r};
  Point(p + 4) = {half * r, half * r, 0};
  Point(p + 5) = {0, half * r, half * r};
  Point(p + 6) = {half * r, 0, half * r};
  Point(p + 7) = {middle * r, middle * r, middle * r};
  Circle(p + 1) = {p + 1, 100, p + 4}; Circle(p + 2) = {p + 4, 100, p + 2};
  Circle(p + 3) = {p + 2, 100, p + 5}; Circle(p + 4) = {p + 5, 100, p + 3};
  Circle(p + 5) = {p + 3, 100, p + 6}; Circle(p + 6) = {p + 6, 100, p + 1};
  Circle(p + 7) = {p + 4, 100, p + 7}; Circle(p + 8) = {p + 5, 100, p + 7};
  Circle(p + 9) = {p + 6, 100, p + 7};
  Curve Loop(p + 1) = {p + 1, p + 7, -(p + 9), p + 6};
  Curve Loop(p + 2) = {p + 3, p + 8, -(p + 7), p + 2};
  Curve Loop(p + 3) = {p + 5, p + 9, -(p + 8), p + 4};
  For i In {1:3}
    Surface(p + i) = {p + i} In Sphere {100};
  EndFor
EndFor

// Radial lines 21 to 27, the faces between the blocks and those in the coordinate planes.
For i In {1:7}
  Line(20 + i) = {i, 10 + i};
EndFor
For i In {1:9}
  from = {1, 4, 2, 5, 3, 6, 4, 5, 6};
  to = {4, 2, 5, 3, 6, 1, 7, 7, 7};
  Curve Loop(20 + i) = {i, 20 + to[i - 1], -(10 + i), -(20 + from[i - 1])};
  Surface(20 + i) = {20 + i};
EndFor
Surface Loop(1) = {1, 11, 21, 27, 29, 26}; Volume(1) = {1};
Surface Loop(2) = {2, 12, 23, 28, 27, 22}; Volume(2) = {2};
Surface Loop(3) = {3, 13, 25, 29, 28, 24}; Volume(3) = {3};

Transfinite Curve {1:9, 11:19} = cells / 2 + 1;
Transfinite Curve {21:27} = layers + 1;
If (tets)
  // Unstructured: the triangles of transfinite surfaces do not match transfinite tetrahedra.
  Mesh.Optimize = 1;
  Mesh.HighOrderOptimize = 3 * (order - 1);  // elastic analogy: gmsh 4.13 aborts in method 1
Else
  Transfinite Surface {1:3, 11:13, 21:29};
  Recombine Surface {1:3, 11:13, 21:29};
  Transfinite Volume {1:3};
EndIf

Physical Volume("body") = {1:3};
Physical Surface("inner") = {1:3};
Physical Surface("outer") = {11:13};
Physical Surface("x = 0") = {23, 24};
Physical Surface("y = 0") = {25, 26};
Physical Surface("z = 0") = {21, 22};

Mesh.ElementOrder = order;
