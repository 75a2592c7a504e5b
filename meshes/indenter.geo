// An octant of a ball of this radius about the origin: x, y >= 0, z <= 0. Its planes of symmetry are the
// surfaces "x = 0", "y = 0" and "z = 0"; its pole (0, 0, -radius) is where a plane touches it. With flat = 1
// it stands for a half-space, which a ball touches at the origin. The tetrahedra have `cells` edges along the
// length `zone` from that point, and grow with the distance from it.
SetFactory("Built-in");
DefineConstant[
  cells = {8, Min 1, Step 1, Name "cells"}
  radius = {50, Name "radius"}
  zone = {5, Name "zone"}
  growth = {0.35, Name "growth"}
  flat = {0, Choices{0, 1}, Name "flat"}
  order = {1, Choices{1, 2}, Name "order"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf
If (!(radius > 0) || !(zone > 0) || !(zone <= radius) || !(growth > 0))
  Error("radius = %g, zone = %g, growth = %g: expected positive numbers, zone <= radius", radius, zone, growth);
EndIf
If (order != 1 && order != 2)
  Error("order = %g: expected 1 or 2", order);
EndIf
If (flat != 0 && flat != 1)
  Error("flat = %g: expected 0 or 1", flat);
EndIf

Point(1) = {0, 0, 0};
Point(2) = {radius, 0, 0}; Point(3) = {0, radius, 0}; Point(4) = {0, 0, -radius};
Line(1) = {1, 2}; Line(2) = {1, 3}; Line(3) = {1, 4};
Circle(4) = {2, 1, 3}; Circle(5) = {3, 1, 4}; Circle(6) = {4, 1, 2};
Curve Loop(1) = {2, 5, -3}; Plane Surface(1) = {1};
Curve Loop(2) = {3, 6, -1}; Plane Surface(2) = {2};
Curve Loop(3) = {1, 4, -2}; Plane Surface(3) = {3};
Curve Loop(4) = {4, 5, 6}; Surface(4) = {4} In Sphere {1};
Surface Loop(1) = {1, 2, 3, 4};
Volume(1) = {1};

Field[1] = MathEval;
Field[1].F = Sprintf("%g + %g * Max(0, Sqrt(x^2 + y^2 + (z + %g)^2) - %g)", zone / cells, growth, (1 - flat) * radius, zone);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeFromCurvature = 0;

Physical Volume("body") = {1};
Physical Surface("x = 0") = {1};
Physical Surface("y = 0") = {2};
Physical Surface("z = 0") = {3};
Physical Surface("surface") = {4};

Mesh.ElementOrder = order;
