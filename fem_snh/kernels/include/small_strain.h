/* Near rest: what the strain is, to a rounding of the strain, from H = F - I.
 *
 * F = I + H drops the digits of H below 1e-16; so does a J, an I_C or a stretch near 1, and lambda is
 * up to a million times mu. What is added to the values at rest is known better:
 *   E = C - I = H + H^T + H^T H            {00, 11, 22, 01, 02, 12}
 *   I_C - 3 = tr E, II_C - 3 = 2 tr E + (minors of E), J - 1 = tr H + (minors of H) + det H
 *   s_i - 1 = e_i/(1 + sqrt(1 + e_i)), e_i the eigenvalues of E */

/* Close enough for E to be as good as F, far enough for F to be as good as E. */
INLINE mask near_rest(const real *H) {
  mask near = absolute(H[0]) <= 0.1;
  for (int i = 1; i < 9; ++i) near &= absolute(H[i]) <= 0.1;
  return near;
}

INLINE void strain_point(const real *H, real *E) {
  for (int i = 0; i < 3; ++i) E[i] = 2 * H[4 * i] + dot(H + 3 * i, H + 3 * i);
  E[3] = H[3] + H[1] + dot(H, H + 3);
  E[4] = H[6] + H[2] + dot(H, H + 6);
  E[5] = H[7] + H[5] + dot(H + 3, H + 6);
}

/* J - 1, and dJ/dF - I. */
INLINE real volume_change(const real *H, real *G) {
  cross(H + 3, H + 6, G);
  cross(H + 6, H, G + 3);
  cross(H, H + 3, G + 6);
  const real trace = H[0] + H[4] + H[8], minors = G[0] + G[4] + G[8], det = dot(H, G);
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) G[3 * j + i] += (i == j ? trace : splat(0)) - H[3 * i + j];
  return trace + (minors + det);
}

/* I_C - 3, II_C - 3 and J - 1. */
INLINE void invariants_change(const real *H, real *change) {
  real E[6], G[9];
  strain_point(H, E);
  change[0] = E[0] + E[1] + E[2];
  change[1] = 2 * change[0] + (E[0] * E[1] - E[3] * E[3] + E[0] * E[2] - E[4] * E[4] + E[1] * E[2] - E[5] * E[5]);
  change[2] = volume_change(H, G);
}

/* P = rest I + length H + area (I_C F - F C - 2 I) + volume (cof F - I), with length = 2 psi_C,
 * area = 2 psi_II, volume = psi_J and rest their sum at F = I, length + 2 area + volume. */
INLINE void stress_near_rest(const real *H, real rest, real length, real area, real volume, real *P) {
  real E[6], G[9];
  strain_point(H, E);
  volume_change(H, G);
  const real S[9] = {E[0], E[3], E[4], E[3], E[1], E[5], E[4], E[5], E[2]}, trace = E[0] + E[1] + E[2];
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) {
      const real HE = H[i] * S[3 * j] + H[3 + i] * S[3 * j + 1] + H[6 + i] * S[3 * j + 2], h = H[3 * j + i];
      const real B = (2 + trace) * h - S[3 * j + i] - HE + (i == j ? trace : splat(0));
      P[3 * j + i] = length * h + area * B + volume * G[3 * j + i] + (i == j ? rest : splat(0));
    }
}

/* The SVD of F = I + H with s and d = s - 1. */
INLINE void svd_near_rest(const real *H, real *U, real *s, real *d, real *V) {
  real E[6], e[3];
  strain_point(H, E);
  eigen3(CUBIC, E, e, V);
  for (int k = 0; k < 3; ++k) {
    d[k] = e[k] / (1 + lane_sqrt(1 + e[k]));
    s[k] = 1 + d[k];
    for (int i = 0; i < 3; ++i)
      U[3 * k + i] = (V[3 * k + i] + H[i] * V[3 * k] + H[3 + i] * V[3 * k + 1] + H[6 + i] * V[3 * k + 2]) / s[k];
  }
}
