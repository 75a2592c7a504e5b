// Rubber between two cylindrical sleeves, inner <= r <= outer, of quadrilaterals, triangles, hexahedra or tetrahedra,
// `cells` of them through the wall: with plane = 1 the rectangle 0 <= y <= length, which revolves about the y axis
// (section = 1), or the whole ring about the origin (section = 0); else the body about the y axis.
// order = 2 gives cells with curved sides.
SetFactory("Built-in");
DefineConstant[
  cells = {4, Min 1, Step 1, Name "cells"}
  inner = {10, Name "inner"}
  outer = {20, Name "outer"}
  length = {30, Name "length"}
  tets = {0, Choices{0, 1}, Name "tets"}
  section = {1, Choices{0, 1}, Name "section"}
  order = {2, Choices{1, 2}, Name "order"}
  plane = {0, Choices{0, 1}, Name "plane"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf
If (!(inner > 0) || !(outer > inner) || !(length > 0))
  Error("inner = %g, outer = %g, length = %g: expected 0 < inner < outer, length > 0", inner, outer, length);
EndIf
If (order != 1 && order != 2)
  Error("order = %g: expected 1 or 2", order);
EndIf

wall = outer - inner;
quarter = Floor(cells * Pi / 4 * (inner + outer) / wall + 0.5);
quarter = quarter < 2 ? 2 : quarter;
along = Floor(cells * length / wall + 0.5);
along = along < 1 ? 1 : along;
body[] = {}; first[] = {}; last[] = {}; ends[] = {};
Point(1) = {inner, 0, 0}; Point(2) = {outer, 0, 0};
Line(1) = {1, 2};
Transfinite Curve {1} = cells + 1;
If (plane && !section)
  line = 1;
  For i In {1:4}
    If (tets)
      made[] = Extrude {{0, 0, 1}, {0, 0, 0}, Pi/2} { Curve{line}; Layers{quarter}; };
    Else
      made[] = Extrude {{0, 0, 1}, {0, 0, 0}, Pi/2} { Curve{line}; Layers{quarter}; Recombine; };
    EndIf
    line = made[0]; body[] += made[1]; first[] += Abs(made[3]); last[] += Abs(made[2]);
  EndFor
Else
  Point(3) = {outer, length, 0}; Point(4) = {inner, length, 0};
  Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
  Curve Loop(1) = {1, 2, 3, 4};
  Plane Surface(1) = {1};
  Transfinite Curve {3} = cells + 1;
  Transfinite Curve {2, 4} = along + 1;
  If (tets)
    Transfinite Surface {1} Alternate;
  Else
    Transfinite Surface {1};
    Recombine Surface {1};
  EndIf
  If (plane)
    body[] = {1}; first[] = {4}; last[] = {2}; ends[] = {1, 3};
  Else
    surface = 1;
    For i In {1:4}
      If (tets)
        made[] = Extrude {{0, 1, 0}, {0, 0, 0}, Pi/2} { Surface{surface}; Layers{quarter}; };
      Else
        made[] = Extrude {{0, 1, 0}, {0, 0, 0}, Pi/2} { Surface{surface}; Layers{quarter}; Recombine; };
      EndIf
      surface = made[0]; body[] += made[1];
      ends[] += {made[2], made[4]}; last[] += made[3]; first[] += made[5];
    EndFor
  EndIf
EndIf
If (plane)
  Physical Surface("body") = {body[]};
  Physical Curve("inner") = {first[]};
  Physical Curve("outer") = {last[]};
Else
  Physical Volume("body") = {body[]};
  Physical Surface("inner") = {first[]};
  Physical Surface("outer") = {last[]};
EndIf
If (#ends[] > 0 && plane)
  Physical Curve("ends") = {ends[]};
EndIf
If (#ends[] > 0 && !plane)
  Physical Surface("ends") = {ends[]};
EndIf
Mesh.ElementOrder = order;
