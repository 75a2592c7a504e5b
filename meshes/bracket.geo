// A bracket: an upright [0,thickness] x [0,height], and on it an arm [0,length] x [height - thickness,height], both
// `depth` deep along z. The corner between them, at (thickness, height - thickness), is re-entrant. `cells` cells along the
// thickness: hexahedra (tets = 0) or tetrahedra (tets = 1); with plane = 1 it is the section alone, of
// quadrilaterals or triangles.
SetFactory("Built-in");
DefineConstant[
  cells = {2, Min 1, Step 1, Name "cells"}
  tets = {0, Choices{0, 1}, Name "tets"}
  plane = {0, Choices{0, 1}, Name "plane"}
  thickness = {1, Name "thickness"}
  length = {3, Name "length"}
  height = {3, Name "height"}
  depth = {1, Name "depth"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf
If (!(thickness > 0) || !(depth > 0) || !(length > thickness) || !(height > thickness))
  Error("thickness = %g, length = %g, height = %g, depth = %g: expected positive numbers, thickness less than length and height", thickness, length, height, depth);
EndIf

x[] = {0, thickness, length};
y[] = {0, height - thickness, height};
For j In {0:2}
  For i In {0:2}
    If (i < 2 || j > 0)
      Point(1 + i + 3 * j) = {x[i], y[j], 0};
    EndIf
  EndFor
EndFor
size = thickness / cells;
// Lines 1 + i + 2 j along x, 11 + i + 3 j along y.
For j In {0:2}
  For i In {0:1}
    If (i < 1 || j > 0)
      Line(1 + i + 2 * j) = {1 + i + 3 * j, 2 + i + 3 * j};
      Transfinite Curve {1 + i + 2 * j} = Ceil((x[i + 1] - x[i]) / size - 1e-9) + 1;
    EndIf
  EndFor
EndFor
For j In {0:1}
  For i In {0:2}
    If (i < 2 || j > 0)
      Line(11 + i + 3 * j) = {1 + i + 3 * j, 4 + i + 3 * j};
      Transfinite Curve {11 + i + 3 * j} = Ceil((y[j + 1] - y[j]) / size - 1e-9) + 1;
    EndIf
  EndFor
EndFor
Curve Loop(1) = {1, 12, -3, -11};
Curve Loop(2) = {3, 15, -5, -14};
Curve Loop(3) = {4, 16, -6, -15};
Plane Surface(1) = {1}; Plane Surface(2) = {2}; Plane Surface(3) = {3};
If (tets)
  Transfinite Surface {1:3} Alternate;
Else
  Transfinite Surface {1:3};
  Recombine Surface {1:3};
EndIf
If (plane)
  Physical Surface("body") = {1:3};
  Physical Curve("bottom") = {1};
  Physical Curve("end") = {16};
  Physical Curve("top") = {5, 6};
Else
  // Extrude returns the opposite surface, the volume, and the side surfaces in the order of the curves.
  body[] = {}; faces[] = {1:3};
  For i In {1:3}
    If (tets)
      part[] = Extrude {0, 0, depth} { Surface{i}; Layers{Ceil(depth / size - 1e-9)}; };
    Else
      part[] = Extrude {0, 0, depth} { Surface{i}; Layers{Ceil(depth / size - 1e-9)}; Recombine; };
    EndIf
    faces[] += part[0];
    body[] += part[1];
    If (i == 1)
      Physical Surface("bottom") = {part[2]};
    EndIf
    If (i == 2)
      above = part[4];
    EndIf
    If (i == 3)
      Physical Surface("end") = {part[3]};
      Physical Surface("top") = {above, part[4]};
    EndIf
  EndFor
  Physical Volume("body") = {body[]};
  Physical Surface("faces") = {faces[]};
EndIf
