// Circular section of a cord: the disc of this radius about (center, 0), or its half x >= center (half = 1), of
// triangles, about `cells` of them along the diameter. With center > radius it revolves to a torus.
// order = 2 gives cells with curved sides.
SetFactory("Built-in");
DefineConstant[
  cells = {8, Min 1, Step 1, Name "cells"}
  radius = {1, Name "radius"}
  center = {0, Name "center"}
  half = {0, Choices{0, 1}, Name "half"}
  order = {2, Choices{1, 2}, Name "order"}
  plane = {1, Choices{0, 1}, Name "plane"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf
If (!(radius > 0))
  Error("radius = %g: expected a positive number", radius);
EndIf
If (order != 1 && order != 2)
  Error("order = %g: expected 1 or 2", order);
EndIf
If (!plane)
  Error("a cord is a mesh of two dimensions: expected triangles");
EndIf

size = 2 * radius / cells;
Point(1) = {center, 0, 0, size};
Point(2) = {center, -radius, 0, size}; Point(3) = {center + radius, 0, 0, size}; Point(4) = {center, radius, 0, size};
Circle(1) = {2, 1, 3}; Circle(2) = {3, 1, 4};
If (half)
  Line(3) = {4, 1}; Line(4) = {1, 2};
  Physical Curve("middle") = {3, 4};
  Physical Curve("surface") = {1, 2};
Else
  Point(5) = {center - radius, 0, 0, size};
  Circle(3) = {4, 1, 5}; Circle(4) = {5, 1, 2};
  Physical Curve("surface") = {1:4};
EndIf
Curve Loop(1) = {1:4};
Plane Surface(1) = {1};
Physical Surface("body") = {1};
Mesh.ElementOrder = order;
