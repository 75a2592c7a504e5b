// Two blocks, one above the other: [0,width]^2 x [0,height], and [shift,shift+upper_width]^2 x
// [height+gap,height+gap+upper_height]. The lower one has `cells` cells along each edge, the upper one
// `upper_cells`; with `layers`, both have so many across their height. Hexahedra (tets = 0) or tetrahedra
// (tets = 1). They have no common node.
// The built-in kernel would merge the blocks where they touch.
SetFactory("OpenCASCADE");
DefineConstant[
  cells = {4, Min 1, Step 1, Name "cells"}
  upper_cells = {0, Min 0, Step 1, Name "upper_cells"}
  width = {1, Name "width"}
  upper_width = {1, Name "upper_width"}
  height = {1, Name "height"}
  upper_height = {0, Name "upper_height"}
  layers = {0, Min 0, Step 1, Name "layers"}
  gap = {0, Name "gap"}
  shift = {0, Name "shift"}
  tets = {0, Choices{0, 1}, Name "tets"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf
If (!(upper_cells >= 0) || upper_cells != Floor(upper_cells))
  Error("upper_cells = %g: expected a whole number, or 0 for that of the lower block", upper_cells);
EndIf
If (!(layers >= 0) || layers != Floor(layers))
  Error("layers = %g: expected a whole number, or 0 for as many as along the other edges", layers);
EndIf
If (!(upper_height >= 0))
  Error("upper_height = %g: expected a positive number, or 0 for that of the lower block", upper_height);
EndIf
If (!(width > 0) || !(upper_width > 0) || !(height > 0))
  Error("width = %g, upper_width = %g, height = %g: expected positive numbers", width, upper_width, height);
EndIf

Box(1) = {0, 0, 0, width, width, height};
Box(2) = {shift, shift, height + gap, upper_width, upper_width, (upper_height > 0) ? upper_height : height};
// A box has 12 curves, of which the odd ones of the first eight are vertical, and the surfaces x-, x+, y-, y+, z-, z+.
Transfinite Curve {1:12} = cells + 1;
If (upper_cells > 0)
  Transfinite Curve {13:24} = upper_cells + 1;
Else
  Transfinite Curve {13:24} = cells + 1;
EndIf
If (layers > 0)
  Transfinite Curve {1, 3, 5, 7, 13, 15, 17, 19} = layers + 1;
EndIf
Transfinite Surface {1:12};
If (!tets)
  Recombine Surface {1:12};
EndIf
Transfinite Volume {1, 2};

Physical Volume("lower") = {1};
Physical Volume("upper") = {2};
Physical Surface("bottom") = {5};
Physical Surface("lower_top") = {6};
Physical Surface("upper_bottom") = {11};
Physical Surface("top") = {12};
Physical Surface("left") = {1, 7};
Physical Surface("right") = {2, 8};
Physical Surface("front") = {3, 9};
Physical Surface("back") = {4, 10};
Physical Surface("lower_surface") = {1:6};
Physical Surface("upper_surface") = {7:12};
Physical Surface("lower_ends") = {1, 2};
