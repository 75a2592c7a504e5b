// Cook's membrane: the panel with corners (0,0), (48,44), (48,60), (0,44) and thickness 1. It has
// `cells` x `cells` x 1 hexahedra (tets = 0), or tetrahedra in the same layer (tets = 1); with plane = 1
// it is the panel alone, of quadrilaterals or triangles.
SetFactory("Built-in");
DefineConstant[
  cells = {16, Min 1, Step 1, Name "cells"}
  tets = {0, Choices{0, 1}, Name "tets"}
  plane = {0, Choices{0, 1}, Name "plane"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf

Point(1) = {0, 0, 0}; Point(2) = {48, 44, 0}; Point(3) = {48, 60, 0}; Point(4) = {0, 44, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1:4} = cells + 1;
If (tets)
  Transfinite Surface {1} Alternate;
Else
  Transfinite Surface {1};
  Recombine Surface {1};
EndIf
If (plane)
  Physical Surface("body") = {1};
  Physical Curve("left") = {4};
  Physical Curve("right") = {2};
  Physical Curve("bottom") = {1};
  Physical Curve("top") = {3};
Else
  If (tets)
    panel[] = Extrude {0, 0, 1} { Surface{1}; Layers{1}; };
  Else
    panel[] = Extrude {0, 0, 1} { Surface{1}; Layers{1}; Recombine; };
  EndIf

  // panel[]: the opposite surface, the volume, and the sides extruded from lines 1 to 4.
  Physical Volume("body") = {panel[1]};
  Physical Surface("left") = {panel[5]};
  Physical Surface("right") = {panel[3]};
  Physical Surface("bottom") = {panel[2]};
  Physical Surface("top") = {panel[4]};
  Physical Surface("faces") = {1, panel[0]};
EndIf
