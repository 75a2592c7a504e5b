// Bar [0,length] x [0,1]^2 of two volumes that meet at x = interface; `cells` cells along an edge of length 1:
// hexahedra (tets = 0) or tetrahedra (tets = 1).
SetFactory("Built-in");
DefineConstant[
  cells = {4, Min 1, Step 1, Name "cells"}
  tets = {0, Choices{0, 1}, Name "tets"}
  length = {2, Min 0, Name "length"}
  interface = {1, Min 0, Name "interface"}
];
If (!(cells >= 1) || cells != Floor(cells))
  Error("cells = %g: expected a whole number, 1 or more", cells);
EndIf
If (!(interface > 0 && interface < length))
  Error("interface = %g: expected a number between 0 and length", interface);
EndIf

Point(1) = {0, 0, 0}; Point(2) = {0, 1, 0}; Point(3) = {0, 1, 1}; Point(4) = {0, 0, 1};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1:4} = cells + 1;
layers_1 = Ceil(cells * interface - 1e-9);
layers_2 = Ceil(cells * (length - interface) - 1e-9);
If (tets)
  // Alternating diagonals make the mesh as stiff in a direction as in its mirror image.
  Transfinite Surface {1} Alternate;
  first[] = Extrude {interface, 0, 0} { Surface{1}; Layers{layers_1}; };
  second[] = Extrude {length - interface, 0, 0} { Surface{first[0]}; Layers{layers_2}; };
Else
  Transfinite Surface {1};
  Recombine Surface {1};
  first[] = Extrude {interface, 0, 0} { Surface{1}; Layers{layers_1}; Recombine; };
  second[] = Extrude {length - interface, 0, 0} { Surface{first[0]}; Layers{layers_2}; Recombine; };
EndIf

// first[], second[]: the opposite surface, the volume, and the sides extruded from lines 1 to 4.
Physical Volume("first") = {first[1]};
Physical Volume("second") = {second[1]};
Physical Surface("left") = {1};
Physical Surface("right") = {second[0]};
Physical Surface("interface") = {first[0]};
Physical Surface("bottom") = {first[2], second[2]};
Physical Surface("back") = {first[3], second[3]};
Physical Surface("top") = {first[4], second[4]};
Physical Surface("front") = {first[5], second[5]};
