// An octopus of tetrahedra: a bell about the z axis, with eight tapering arms around its rim. `radius` [m]
// is the bell's at the arms; `length` and `tip`, the length of an arm and the radius of its tip, are
// relative to it. `cells` is the number of cells from the tip of an arm to that of the opposite one.
//
//   cells = 54    about  20,000 tetrahedra
//   cells = 157   about 392,000 tetrahedra, as many as in Figure 11 of Smith et al. 2018
//
// Two rings of curves around the bell leave a round hole for each arm. Sixteen patches go up to a flat
// crown, sixteen to the flat ceiling of the hollow underneath. Four patches are the sides of an arm.
SetFactory("Built-in");
DefineConstant[
  cells = {54, Min 4, Step 1, Name "cells"}
  radius = {0.07, Name "radius"}
  length = {3, Name "length"}
  tip = {0.1, Name "tip"}
  tets = {1, Choices{0, 1}, Name "tets"}   // 1: there are no hexahedra
];
If (!(cells >= 4))
  Error("cells = %g: expected a number of at least 4", cells);
EndIf
If (!(radius > 0))
  Error("radius = %g: expected a positive number", radius);
EndIf
If (!(length >= 1 && length <= 6))
  Error("length = %g: expected a number from 1 to 6", length);
EndIf
If (!(tip >= 0.05 && tip <= 0.25))
  Error("tip = %g: expected a number from 0.05 to 0.25", tip);
EndIf
If (!tets)
  Error("cell = hexahedron: expected tetrahedron, as an octopus has no hexahedra");
EndIf

arms = 8;
step = 2 * Pi / arms;
root = 0.29 * radius;     // radius of an arm at the bell; Sin(step / 2) would leave no gap between arms
side = root / Sqrt(2);    // half the distance of the corners of a hole
coarse = 2 * (1 + length) * radius / cells;
fine = 0.63 * coarse;      // size of the cells at the tips
up_r[] = {1, 1.08, 1.10, 0.93, 0.64, 0.32};   // a meridian of the bell, in units of radius
up_z[] = {0, 0.70, 1.15, 1.65, 2.00, 2.10};
down_r[] = {1, 0.75, 0.36};                   // one of its hollow
down_z[] = {0, -0.05, 0.15};
Point(1) = {0, 0, side};
Point(2) = {0, 0, -side};
Point(3) = {0, 0, 2.10 * radius};
Point(4) = {0, 0, 0.15 * radius};

// Curves of the bell. The corners of hole k are p + 1 to p + 4, from the lower one at the larger angle to
// the lower one at the smaller angle; the middles of its sides p + 5 to p + 8; its meridians p + 5 to p + 8.
For k In {0:arms - 1}
  p = 100 * (k + 1);
  For i In {1:4}
    a = k * step + (i <= 2 ? 1 : -1) * side / radius;
    upper = i == 2 || i == 3;
    Point(p + i) = {radius * Cos(a), radius * Sin(a), upper ? side : -side, coarse};
    b = k * step + (i == 1 ? 1 : i == 3 ? -1 : 0) * root / radius;
    Point(p + 4 + i) = {radius * Cos(b), radius * Sin(b), i == 2 ? root : i == 4 ? -root : 0, coarse};
    line[] = {p + i};
    If (upper)
      r[] = up_r[]; h[] = up_z[];
    Else
      r[] = down_r[]; h[] = down_z[];
    EndIf
    For j In {1:#r[] - 1}
      Point(p + 10 * i + j) = {radius * r[j] * Cos(a), radius * r[j] * Sin(a), radius * h[j], coarse};
      line[] += p + 10 * i + j;
    EndFor
    Spline(p + 4 + i) = line[];
  EndFor
  For i In {1:4}
    Spline(p + i) = {p + i, p + 4 + i, p + 1 + i % 4};
  EndFor
EndFor

// Arcs of the gaps (9 above, 10 below), of the crown (11, 12) and of the ceiling (13, 14).
bell[] = {}; crown[] = {}; ceiling[] = {};
For k In {0:arms - 1}
  p = 100 * (k + 1);
  q = 100 * ((k + 1) % arms + 1);
  Circle(p + 9) = {p + 2, 1, q + 3};
  Circle(p + 10) = {p + 1, 2, q + 4};
  Circle(p + 11) = {p + 35, 3, p + 25};
  Circle(p + 12) = {p + 25, 3, q + 35};
  Circle(p + 13) = {p + 42, 4, p + 12};
  Circle(p + 14) = {p + 12, 4, q + 42};
  Curve Loop(p + 1) = {-(p + 2), p + 6, -(p + 11), -(p + 7)};
  Curve Loop(p + 2) = {p + 9, q + 7, -(p + 12), -(p + 6)};
  Curve Loop(p + 3) = {p + 4, p + 5, -(p + 13), -(p + 8)};
  Curve Loop(p + 4) = {p + 10, q + 8, -(p + 14), -(p + 5)};
  Curve Loop(p + 5) = {p + 1, p + 9, q + 3, -(p + 10)};
  For i In {1:5}
    Surface(p + i) = {p + i};
    bell[] += p + i;
  EndFor
  crown[] += {p + 11, p + 12};
  ceiling[] += {p + 13, p + 14};
EndFor
Curve Loop(1) = crown[]; Plane Surface(1) = {1};
Curve Loop(2) = ceiling[]; Plane Surface(2) = {2};
bell[] += {1, 2};

// Arms: the axis leaves the bell horizontally, sinks, and curls up again. Splines through the corners of the
// sections, which are normal to the axis, are the edges of the sides.
sections = 8;
tentacles[] = {};
For k In {0:arms - 1}
  p = 100 * (k + 1);
  q = 1000 * (k + 1);
  c = Cos(k * step); s = Sin(k * step);
  out = radius; z = 0;
  For j In {1:sections}
    t = (j - 0.5) / sections;
    sink = -0.6 * Sin(Pi * t) + 0.6 * t^2;
    out += length * radius / sections * Cos(sink);
    z += length * radius / sections * Sin(sink);
    t = j / sections;
    sink = -0.6 * Sin(Pi * t) + 0.6 * t^2;
    thick = root + t * (tip * radius - root);
    size = coarse + t * (fine - coarse);
    For i In {1:4}
      x = (i <= 2 ? 1 : -1) * thick / Sqrt(2);
      y = ((i == 2 || i == 3) ? 1 : -1) * thick / Sqrt(2);
      d = out - y * Sin(sink);
      Point(q + 10 * j + i) = {d * c - x * s, d * s + x * c, z + y * Cos(sink), size};
    EndFor
  EndFor
  Point(q) = {out * c, out * s, z, size};
  For i In {1:4}
    rail[] = {p + i};
    For j In {1:sections}
      rail[] += q + 10 * j + i;
    EndFor
    Spline(q + i) = rail[];
    Circle(q + 10 + i) = {q + 10 * sections + i, q, q + 10 * sections + 1 + i % 4};
  EndFor
  For i In {1:4}
    Curve Loop(q + i) = {p + i, q + 1 + i % 4, -(q + 10 + i), -(q + i)};
    Surface(q + i) = {q + i};
    tentacles[] += q + i;
  EndFor
  Curve Loop(q + 5) = {q + 11, q + 12, q + 13, q + 14};
  Plane Surface(q + 5) = {q + 5};
  tentacles[] += q + 5;
EndFor

Surface Loop(1) = {bell[], tentacles[]};
Volume(1) = {1};
Physical Volume("body") = {1};
Physical Surface("surface") = {bell[], tentacles[]};
Physical Surface("bell") = {bell[]};
Physical Surface("arms") = {tentacles[]};

Mesh.Algorithm = 6;   // Frontal-Delaunay
Mesh.Optimize = 1;
