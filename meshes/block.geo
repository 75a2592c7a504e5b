// A quarter of a block that is pressed in the middle of its top: [0,side]^2 x [0,height]. The planes
// x = 0 and y = 0 are planes of symmetry; the surface "patch" is [0,side/2]^2 on the top. There are
// `cells` (an even number) cells along each edge: hexahedra (tets = 0) or tetrahedra (tets = 1).
SetFactory("Built-in");
DefineConstant[
  cells = {8, Min 2, Step 2, Name "cells"}
  side = {50, Name "side"}
  height = {50, Name "height"}
  tets = {0, Choices{0, 1}, Name "tets"}
];
If (!(cells >= 2) || cells / 2 != Floor(cells / 2))
  Error("cells = %g: expected an even whole number, 2 or more", cells);
EndIf
If (!(side > 0) || !(height > 0))
  Error("side = %g, height = %g: expected positive numbers", side, height);
EndIf

half = side / 2;
For j In {0:2}
  For i In {0:2}
    Point(1 + i + 3 * j) = {i * half, j * half, 0};
  EndFor
EndFor
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {4, 5}; Line(4) = {5, 6}; Line(5) = {7, 8}; Line(6) = {8, 9};
Line(7) = {1, 4}; Line(8) = {2, 5}; Line(9) = {3, 6}; Line(10) = {4, 7}; Line(11) = {5, 8}; Line(12) = {6, 9};
Curve Loop(1) = {1, 8, -3, -7};
Curve Loop(2) = {2, 9, -4, -8};
Curve Loop(3) = {3, 11, -5, -10};
Curve Loop(4) = {4, 12, -6, -11};
Plane Surface(1) = {1}; Plane Surface(2) = {2}; Plane Surface(3) = {3}; Plane Surface(4) = {4};
Transfinite Curve {1:12} = cells / 2 + 1;
If (tets)
  Transfinite Surface {1:4} Alternate;
Else
  Transfinite Surface {1:4};
  Recombine Surface {1:4};
EndIf

// Extrude returns the opposite surface, the volume, and the side surfaces in the order of the curves.
top[] = {}; body[] = {}; sides[] = {};
For i In {1:4}
  If (tets)
    part[] = Extrude {0, 0, height} { Surface{i}; Layers{cells}; };
  Else
    part[] = Extrude {0, 0, height} { Surface{i}; Layers{cells}; Recombine; };
  EndIf
  top[] += part[0];
  body[] += part[1];
  sides[] += {part[2], part[3], part[4], part[5]};
EndFor

Physical Volume("body") = {body[]};
Physical Surface("bottom") = {1:4};
Physical Surface("top") = {top[]};
Physical Surface("patch") = {top[0]};
Physical Surface("front") = {sides[0], sides[4]};
Physical Surface("left") = {sides[3], sides[11]};
