"""Cook's membrane in plane strain, or in a layer: values of much finer meshes."""

#: Displacement of the corner by nu: Q2Q1 on 32 cells (nu = 0.3), else on 64; errors below 0.4 %.
CORNER = {
    0.3: {"corner.x": -7.016215, "corner.y": 7.831920},
    0.4999: {"corner.x": -5.823763, "corner.y": 6.924679},
}
#: By nu, extrapolated from Q2Q1 on 64 cells (docs/results/error.md).
EXTRAPOLATED = {
    0.3: {"corner.y": 7.8368, "energy": -416.84},
    0.4: {"corner.y": 7.4774, "energy": -393.82},
    0.49: {"corner.y": 6.9965, "energy": -364.27},
}
