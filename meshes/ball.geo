// Ball of this radius about the origin: tetrahedra, about `cells` of them along its diameter.
SetFactory("OpenCASCADE");
DefineConstant[
  cells = {8, Min 1, Step 1, Name "cells"}
  radius = {0.5, Name "radius"}
  order = {1, Choices{1, 2}, Name "order"}
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

Sphere(1) = {0, 0, 0, radius};
Mesh.MeshSizeMin = 2 * radius / cells;
Mesh.MeshSizeMax = 2 * radius / cells;

Physical Volume("body") = {1};
Physical Surface("surface") = {1};

Mesh.ElementOrder = order;
