// An arm of tetrahedra along the x axis, 0.52 m long, its flexor side towards +z: flesh around two bones,
// the humerus and the ulna (which stands for ulna and radius). The volumes `flesh`, `humerus` and `ulna`
// share the nodes between them. The elbow turns about the y axis. Lengths are in metres. `cells` is the
// number of cells along the arm; `biceps` is the height of the biceps, which the flesh bulges over;
// `hollow` is the depth of the hollow in front of the elbow; `thickness` scales the sections of the
// flesh, not those of the bones. order = 2 gives cells with curved faces.
//
//   cells = 12    about  1,100 tetrahedra
//   cells = 40    about 11,200 tetrahedra
//
// With order = 2 there are at least 8 cells around a bone: 6,200 tetrahedra for 12, 11,800 for 40.
SetFactory("OpenCASCADE");
// Twenty times faster for curved faces than the default, which finds the nearest point also beside the
// pole of a sphere; here nodes stay on the surface, and move by 0.05 of an edge along it at most.
Geometry.OCCUseGenericClosestPoint = 1;
DefineConstant[
  cells = {40, Min 12, Step 1, Name "cells"}
  biceps = {0.006, Min 0, Max 0.03, Name "biceps"}
  hollow = {0.01, Min 0, Max 0.01, Name "hollow"}
  thickness = {1, Min 0.9, Max 1.5, Name "thickness"}
  order = {1, Choices{1, 2}, Name "order"}
  tets = {1, Choices{0, 1}, Name "tets"}   // 1: there are no hexahedra
];
If (!(cells >= 12))
  Error("cells = %g: expected a number of at least 12, as larger cells would cut the bones", cells);
EndIf
If (!(biceps >= 0 && biceps <= 0.03))
  Error("biceps = %g: expected a number from 0 to 0.03", biceps);
EndIf
If (!(hollow >= 0 && hollow <= 0.01))
  Error("hollow = %g: expected a number from 0 to 0.01", hollow);
EndIf
If (!(thickness >= 0.9 && thickness <= 1.5))
  Error("thickness = %g: expected a number from 0.9 to 1.5", thickness);
EndIf
If (order != 1 && order != 2)
  Error("order = %g: expected 1 or 2", order);
EndIf
If (!tets)
  Error("cell = hexahedron: expected tetrahedron, as an arm has no hexahedra");
EndIf

// Sections of the flesh, through which a smooth surface goes: their x, and how far they reach in the
// directions +z, -z and +-y from the points (x, 0, middle).
middle = -0.006;
x[]     = {-0.280, -0.230, -0.180, -0.130, -0.085, -0.0450, 0.000, 0.0450, 0.090, 0.150, 0.240};
front[] = { 0.044,  0.044,  0.043,  0.042,  0.039,  0.0320, 0.025, 0.0305, 0.036, 0.030, 0.024};
back[]  = { 0.044,  0.046,  0.047,  0.046,  0.043,  0.0400, 0.038, 0.0370, 0.035, 0.030, 0.024};
side[]  = { 0.041,  0.042,  0.042,  0.041,  0.039,  0.0390, 0.041, 0.0430, 0.040, 0.034, 0.028};
bulge[] = { 0,      0.1,    0.6,    1,      0.6,    0.1,    0,     0,      0,     0,     0    };
dip[]   = { 0,      0,      0,      0.1,    0.4,    0.9,    1,     0.85,   0.4,   0,     0    };
around = 12;   // points of a section
For k In {0:#x[] - 1}
  ring[] = {};
  For i In {0:around - 1}
    a = 2 * Pi * i / around;
    height = Sin(a) > 0 ? front[k] + bulge[k] * biceps - dip[k] * hollow : back[k];
    p = newp;
    Point(p) = {x[k], thickness * side[k] * Cos(a), middle + thickness * height * Sin(a)};
    ring[] += p;
  EndFor
  Spline(k + 1) = {ring[], ring[0]};
  Wire(k + 1) = {k + 1};
EndFor
ThruSections(1) = {1:#x[]};

// Bones with round ends, from the shoulder to the elbow and from the elbow to the wrist: centres and
// radii of their ends. At the elbow they are behind its axis, as far as keeps the length between them
// when it turns.
bone_x[] = {-0.256, -0.045, 0.045, 0.222};
bone_z[] = {-0.010, -0.022, -0.022, -0.010};
bone_r[] = {0.011, 0.011, 0.011, 0.011};
bones[] = {};
For k In {0:2:2}
  p = newp;
  r = bone_r[k];
  end_r = bone_r[k + 1];
  across = bone_z[k + 1] - bone_z[k];
  along = bone_x[k + 1] - bone_x[k];
  long = Hypot(along, across);
  Point(p) = {0, 0, 0};
  Point(p + 1) = {-r, 0, 0};
  Point(p + 2) = {0, 0, r};
  Point(p + 3) = {long, 0, end_r};
  Point(p + 4) = {long + end_r, 0, 0};
  Point(p + 5) = {long, 0, 0};
  c = newc;
  Circle(c) = {p + 1, p, p + 2};
  Line(c + 1) = {p + 2, p + 3};
  Circle(c + 2) = {p + 3, p + 5, p + 4};
  Line(c + 3) = {p + 4, p + 1};
  l = newll;
  Curve Loop(l) = {c, c + 1, c + 2, c + 3};
  s = news;
  Plane Surface(s) = {l};
  bone[] = Extrude {{1, 0, 0}, {0, 0, 0}, 2 * Pi} { Surface{s}; };
  Recursive Delete { Surface{s}; }
  Rotate {{0, 1, 0}, {0, 0, 0}, -Atan2(across, along)} { Volume{bone[1]}; }
  Translate {bone_x[k], 0, bone_z[k]} { Volume{bone[1]}; }
  bones[] += bone[1];
EndFor
BooleanFragments{ Volume{1}; Delete; }{ Volume{bones[]}; Delete; }

// The fragments by their places: their numbers depend on the version of OpenCASCADE.
humerus[] = Volume In BoundingBox{-0.27, -0.02, -0.04, 0, 0.02, 0.02};
ulna[] = Volume In BoundingBox{0, -0.02, -0.04, 0.235, 0.02, 0.02};
flesh[] = Volume{:};
flesh[] -= {humerus[], ulna[]};
skin[] = CombinedBoundary{ Volume{:}; };

size = 0.52 / cells;
Mesh.MeshSizeMin = 0.6 * size;
Mesh.MeshSizeMax = size;
If (order == 2)   // larger cells would be inverted at the bones, and straightened: they lost a tenth
  Mesh.MeshSizeFromCurvature = 8;   // cells around a circle
  Mesh.MeshSizeMin = 0;
EndIf
MeshSize{ PointsOf{ Volume{humerus[], ulna[]}; } } = 0.6 * size;

Physical Volume("flesh") = {flesh[]};
Physical Volume("humerus") = {humerus[]};
Physical Volume("ulna") = {ulna[]};
Physical Surface("skin") = {skin[]};

Mesh.Algorithm = 6;   // Frontal-Delaunay
Mesh.Optimize = 1;
Mesh.ElementOrder = order;
