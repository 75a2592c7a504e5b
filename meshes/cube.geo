// Unit cube [0,1]^3 with `cells` cells along each edge: hexahedra (tets = 0) or tetrahedra (tets = 1).
SetFactory("Built-in");
DefineConstant[
  cells = {15, Min 1, Step 1, Name "cells"}
  tets = {0, Choices{0, 1}, Name "tets"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf

Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Point(3) = {1, 1, 0}; Point(4) = {0, 1, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1:4} = cells + 1;
If (tets)
  // Alternating diagonals make the mesh as stiff in a direction as in its mirror image.
  Transfinite Surface {1} Alternate;
  box[] = Extrude {0, 0, 1} { Surface{1}; Layers{cells}; };
Else
  Transfinite Surface {1};
  Recombine Surface {1};
  box[] = Extrude {0, 0, 1} { Surface{1}; Layers{cells}; Recombine; };
EndIf

// box[]: the opposite surface, the volume, and the sides extruded from lines 1 to 4.
Physical Volume("body") = {box[1]};
Physical Surface("left") = {box[5]};
Physical Surface("right") = {box[3]};
Physical Surface("bottom") = {1};
Physical Surface("top") = {box[0]};
Physical Surface("front") = {box[2]};
Physical Surface("back") = {box[4]};
Physical Point("corners") = {PointsOf{ Volume{box[1]}; }};
// One physical point for each corner, named by its coordinates.
For i In {0:1}
  For j In {0:1}
    For k In {0:1}
      Physical Point(Sprintf("corner_%g%g%g", i, j, k)) =
        Point In BoundingBox {i - 0.1, j - 0.1, k - 0.1, i + 0.1, j + 0.1, k + 0.1};
    EndFor
  EndFor
EndFor
