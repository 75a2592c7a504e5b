// Circular section of a cord: the disc of this radius about (center, 0), or its half x >= center (half = 1), of
// triangles, about `cells` of them along the diameter. With center > radius it revolves to a torus. With plane = 0 it
// is a sector of that torus about the y axis, of this angle [degrees], of tetrahedra, `layers` of them along it.
// order = 2 gives cells with curved sides.
SetFactory("Built-in");
DefineConstant[
  cells = {8, Min 1, Step 1, Name "cells"}
  radius = {1, Name "radius"}
  center = {5, Name "center"}
  half = {0, Choices{0, 1}, Name "half"}
  order = {2, Choices{1, 2}, Name "order"}
  sector = {15, Name "sector"}
  layers = {2, Min 1, Step 1, Name "layers"}
  tets = {1, Choices{0, 1}, Name "tets"}   // 1: there are no hexahedra
  plane = {0, Choices{0, 1}, Name "plane"}
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
If (!plane && !tets)
  Error("cell = hexahedron: expected tetrahedron, as a cord has no hexahedra");
EndIf
If (!plane && (!(center > radius) || !(sector > 0 && sector < 180) || half))
  Error("center = %g, sector = %g, half = %g: expected center > radius, 0 < sector < 180, half = 0", center, sector, half);
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
  If (plane)
    Physical Curve("surface") = {1:4};
  EndIf
EndIf
Curve Loop(1) = {1:4};
Plane Surface(1) = {1};
If (plane)
  Physical Surface("body") = {1};
Else
  // made[]: the opposite surface, the volume, and the sides extruded from curves 1 to 4.
  made[] = Extrude {{0, 1, 0}, {0, 0, 0}, -sector * Pi / 180} { Surface{1}; Layers{layers}; };
  Physical Volume("body") = {made[1]};
  Physical Surface("start") = {1};
  Physical Surface("end") = {made[0]};
  Physical Surface("surface") = {made[2], made[3], made[4], made[5]};
EndIf
Mesh.ElementOrder = order;
