// Thick-walled tube, inner <= r <= outer, of quadrilaterals or triangles, `cells` of them through the wall:
// a quarter of its cross-section in the plane (section = 0), with arcs, or the rectangle 0 <= y <= length, which
// revolves about the y axis (section = 1). order = 2 gives cells with curved sides.
SetFactory("Built-in");
DefineConstant[
  cells = {8, Min 1, Step 1, Name "cells"}
  inner = {1, Name "inner"}
  outer = {2, Name "outer"}
  length = {1, Name "length"}
  tets = {0, Choices{0, 1}, Name "tets"}
  section = {0, Choices{0, 1}, Name "section"}
  order = {2, Choices{1, 2}, Name "order"}
  plane = {1, Choices{0, 1}, Name "plane"}
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
If (!plane)
  Error("a tube is a mesh of two dimensions: expected quadrilaterals or triangles");
EndIf

wall = outer - inner;
Point(1) = {inner, 0, 0}; Point(2) = {outer, 0, 0};
Line(1) = {1, 2};
If (section)
  Point(3) = {outer, length, 0}; Point(4) = {inner, length, 0};
  Line(2) = {2, 3}; Line(4) = {4, 1};
  across = Floor(cells * length / wall + 0.5);
Else
  Point(3) = {0, outer, 0}; Point(4) = {0, inner, 0}; Point(5) = {0, 0, 0};
  Circle(2) = {2, 5, 3}; Circle(4) = {4, 5, 1};
  across = Floor(cells * Pi / 4 * (inner + outer) / wall + 0.5);
EndIf
Line(3) = {3, 4};
across = across < 1 ? 1 : across;
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1, 3} = cells + 1;
Transfinite Curve {2, 4} = across + 1;
If (tets)
  Transfinite Surface {1} Alternate;
Else
  Transfinite Surface {1};
  Recombine Surface {1};
EndIf
Physical Surface("body") = {1};
Physical Curve("start") = {1};
Physical Curve("outer") = {2};
Physical Curve("end") = {3};
Physical Curve("inner") = {4};
Mesh.ElementOrder = order;
