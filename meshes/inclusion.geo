// Unit cube [0,1]^3 with an inclusion around its centre: a sphere (bar = 0) or a bar along x (bar = 1). Some `cells`
// cells along an edge: tetrahedra (tets = 1), or hexahedra (tets = 0), four for each tetrahedron of half as many.
SetFactory("OpenCASCADE");
DefineConstant[
  cells = {8, Min 2, Step 1, Name "cells"}
  tets = {0, Choices{0, 1}, Name "tets"}
  bar = {0, Choices{0, 1}, Name "bar"}
];
least = bar ? 1 : (tets ? 2 : 3);   // larger cells would lose the sphere
If (!(cells >= least) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, %g or more", cells, least);
EndIf

Box(1) = {0, 0, 0, 1, 1, 1};
If (bar)
  Box(2) = {0.19, 0.39, 0.39, 0.62, 0.22, 0.22};
Else
  Sphere(2) = {0.5, 0.5, 0.5, 0.3};
EndIf
parts[] = BooleanFragments{ Volume{1}; Delete; }{ Volume{2}; Delete; };
MeshSize {:} = tets ? 1 / cells : 2 / cells;
Mesh.SubdivisionAlgorithm = tets ? 0 : 2;
Mesh.SecondOrderLinear = !tets;  // nodes that are projected onto the sphere would invert hexahedra

e = 1e-3;
Physical Volume("inclusion") = {2};
Physical Volume("matrix") = {parts[]};
Physical Volume("matrix") -= {2};
Physical Surface("left") = Surface In BoundingBox {-e, -e, -e, e, 1 + e, 1 + e};
Physical Surface("right") = Surface In BoundingBox {1 - e, -e, -e, 1 + e, 1 + e, 1 + e};
Physical Surface("front") = Surface In BoundingBox {-e, -e, -e, 1 + e, e, 1 + e};
Physical Surface("back") = Surface In BoundingBox {-e, 1 - e, -e, 1 + e, 1 + e, 1 + e};
Physical Surface("bottom") = Surface In BoundingBox {-e, -e, -e, 1 + e, 1 + e, e};
Physical Surface("top") = Surface In BoundingBox {-e, -e, 1 - e, 1 + e, 1 + e, 1 + e};
