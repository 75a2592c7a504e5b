/* The small-strain branch: invariants, stretches and stress computed from H = grad u = F - I.
 *
 * F = I + H rounds H to 1e-16 absolute, and J, I_C and the stretches of F have this absolute error too. With
 * lambda up to 1e6 mu, the error in J - 1 would dominate the stress. The increments from the rest state
 * are accurate relative to H:
 *   E = C - I = H + H^T + H^T H            stored as {00, 11, 22, 01, 02, 12}
 *   I_C - 3 = tr E,  II_C - 3 = 2 tr E + (principal minors of E)
 *   J - 1 = tr H + (principal minors of H) + det H
 *   s_i - 1 = e_i/(1 + sqrt(1 + e_i)),  e_i the eigenvalues of E */

/* The lanes that use this branch: |H_ij| <= 0.1. At the limit F determines H to a relative 1e-15, so both
 * branches are accurate there. */
INLINE mask small_strain(const real *H) {
  mask small = absolute(H[0]) <= 0.1;
  for (int i = 1; i < 9; ++i) small &= absolute(H[i]) <= 0.1;
  return small;
}

/* E = H + H^T + H^T H, twice the Green-Lagrange strain. */
INLINE void strain_point(const real *H, real *E) {
  for (int i = 0; i < 3; ++i) E[i] = 2 * H[4 * i] + dot(H + 3 * i, H + 3 * i);
  E[3] = H[3] + H[1] + dot(H, H + 3);
  E[4] = H[6] + H[2] + dot(H, H + 6);
  E[5] = H[7] + H[5] + dot(H + 3, H + 6);
}

/* Returns J - 1 and computes G = cof F - I, by columns. */
INLINE real volume_increment(const real *H, real *G) {
  cross(H + 3, H + 6, G);
  cross(H + 6, H, G + 3);
  cross(H, H + 3, G + 6);
  const real trace = H[0] + H[4] + H[8], minors = G[0] + G[4] + G[8], det = dot(H, G);
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) G[3 * j + i] += (i == j ? trace : splat(0)) - H[3 * i + j];
  return trace + (minors + det);
}

/* change = {I_C - 3, II_C - 3, J - 1}. */
INLINE void invariant_increments(const real *H, real *change) {
  real E[6], G[9];
  strain_point(H, E);
  change[0] = E[0] + E[1] + E[2];
  change[1] = 2 * change[0] + (E[0] * E[1] - E[3] * E[3] + E[0] * E[2] - E[4] * E[4] + E[1] * E[2] - E[5] * E[5]);
  change[2] = volume_increment(H, G);
}

/* P = P0 I + a H + b (I_C F - F C - 2 I) + c (cof F - I), where a = 2 psi_C, b = 2 psi_II, c = psi_J
 * (derivatives at F) and P0 = a + 2 b + c, computed without cancellation by the generated code. */
INLINE void small_strain_stress(const real *H, real P0, real a, real b, real c, real *P) {
  real E[6], G[9];
  strain_point(H, E);
  volume_increment(H, G);
  const real S[9] = {E[0], E[3], E[4], E[3], E[1], E[5], E[4], E[5], E[2]}, trace = E[0] + E[1] + E[2];
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) {
      const real HE = H[i] * S[3 * j] + H[3 + i] * S[3 * j + 1] + H[6 + i] * S[3 * j + 2], h = H[3 * j + i];
      const real B = (2 + trace) * h - S[3 * j + i] - HE + (i == j ? trace : splat(0));
      P[3 * j + i] = a * h + b * B + c * G[3 * j + i] + (i == j ? P0 : splat(0));
    }
}

/* The SVD of F = I + H from the eigenpairs of E: s, and d = s - 1 to the accuracy of H. */
INLINE void small_strain_svd(const real *H, real *U, real *s, real *d, real *V) {
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
