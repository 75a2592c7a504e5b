// A clip, open at one end: two arms [0,1+arm] x [0,depth] x [0,1] and the same from z = 1 + gap on, joined by a
// back [0,1] x [0,depth] x [1,1+gap]; `cells` cells along an edge of length 1: hexahedra (tets = 0) or tetrahedra
// (tets = 1). Pressed together, the arms touch each other.
SetFactory("Built-in");
DefineConstant[
  cells = {2, Min 1, Step 1, Name "cells"}
  tets = {0, Choices{0, 1}, Name "tets"}
  arm = {3, Name "arm"}
  gap = {1, Name "gap"}
  depth = {1, Name "depth"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf
If (!(arm > 0) || !(gap > 0) || !(depth > 0))
  Error("arm = %g, gap = %g, depth = %g: expected positive numbers", arm, gap, depth);
EndIf

x[] = {0, 1, 1 + arm};
z[] = {0, 1, 1 + gap, 2 + gap};
For j In {0:3}
  For i In {0:2}
    Point(1 + i + 3 * j) = {x[i], 0, z[j]};
  EndFor
EndFor
// Lines 1 + i + 2 j along x, 11 + i + 3 j along z; none joins the arms at the open end.
For j In {0:3}
  For i In {0:1}
    Line(1 + i + 2 * j) = {1 + i + 3 * j, 2 + i + 3 * j};
    Transfinite Curve {1 + i + 2 * j} = Ceil(cells * (x[i + 1] - x[i]) - 1e-9) + 1;
  EndFor
EndFor
For j In {0:2}
  For i In {0:2}
    If (i < 2 || j != 1)
      Line(11 + i + 3 * j) = {1 + i + 3 * j, 4 + i + 3 * j};
      Transfinite Curve {11 + i + 3 * j} = Ceil(cells * (z[j + 1] - z[j]) - 1e-9) + 1;
    EndIf
  EndFor
EndFor
Curve Loop(1) = {1, 12, -3, -11};
Curve Loop(2) = {2, 13, -4, -12};
Curve Loop(3) = {3, 15, -5, -14};
Curve Loop(4) = {5, 18, -7, -17};
Curve Loop(5) = {6, 19, -8, -18};
Plane Surface(1) = {1}; Plane Surface(2) = {2}; Plane Surface(3) = {3}; Plane Surface(4) = {4}; Plane Surface(5) = {5};
If (tets)
  Transfinite Surface {1:5} Alternate;
Else
  Transfinite Surface {1:5};
  Recombine Surface {1:5};
EndIf

// Extrude returns the opposite surface, the volume, and the side surfaces in the order of the curves.
body[] = {}; sides[] = {};
For i In {1:5}
  If (tets)
    part[] = Extrude {0, depth, 0} { Surface{i}; Layers{Ceil(cells * depth - 1e-9)}; };
  Else
    part[] = Extrude {0, depth, 0} { Surface{i}; Layers{Ceil(cells * depth - 1e-9)}; Recombine; };
  EndIf
  body[] += part[1];
  sides[] += {part[2], part[3], part[4], part[5]};
EndFor

Physical Volume("body") = {body[]};
Physical Surface("bottom") = {sides[0], sides[4]};
Physical Surface("top") = {sides[14], sides[18]};
Physical Surface("back") = {sides[3], sides[11], sides[15]};
Physical Surface("lower_tip") = {sides[5]};
Physical Surface("upper_tip") = {sides[17]};
Physical Surface("slot") = {sides[6], sides[9], sides[16]};
