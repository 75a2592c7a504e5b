/* Loops over points for pointwise_api.h, W points at a time. */

/* H = F - I; exact for F near I (Sterbenz). */
INLINE void subtract_identity(const real *F, real *H) {
  for (int i = 0; i < 9; ++i) H[i] = F[i] - (i % 4 == 0);
}

/* Eigenvector k as a 9-vector, vec(U D_k V^T) (Smith et al. 2018, eq. 39, 62 and Appendix A). */
INLINE void eigenvector_point(int k, const real *Q, const real *U, const real *V, real *d) {
  if (k < 3) {
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i)
        d[3 * j + i] = Q[3 * k] * U[i] * V[j] + Q[3 * k + 1] * U[3 + i] * V[3 + j] + Q[3 * k + 2] * U[6 + i] * V[6 + j];
    return;
  }
  const int axis = k % 3, a = axis == 0, b = axis == 2 ? 1 : 2; /* the stretches that twist or flip k couples */
  const double sign = k < 6 ? -1.0 : 1.0, r = 0.70710678118654752440; /* 1/sqrt 2 */
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      d[3 * j + i] = r * (U[3 * a + i] * V[3 * b + j] + sign * (U[3 * b + i] * V[3 * a + j]));
}

void energy_points(const double *constants, long n, const double *F, double *psi) {
  const Parameters p = {constants};
  for (long start = 0; start < n; start += W) {
    real f[9], h[9], value[1];
    load_points(F, n, start, f);
    subtract_identity(f, h);
    energy_point(p, f, h, value);
    STORE(psi, 1, value)
  }
}

void stress_points(const double *constants, long n, const double *F, double *P) {
  const Parameters p = {constants};
  for (long start = 0; start < n; start += W) {
    real f[9], h[9], stress[9];
    load_points(F, n, start, f);
    subtract_identity(f, h);
    stress_point(p, f, h, stress);
    STORE(P, 9, stress)
  }
}

void hessian_points(const double *constants, long n, const double *F, int filter, int solver, double *C) {
  const Parameters p = {constants};
  for (long start = 0; start < n; start += W) {
    real f[9], c[81];
    load_points(F, n, start, f);
    hessian_point(p, f, filter, solver, c);
    STORE(C, 81, c)
  }
}

void eigensystem_points(const double *constants, long n, const double *F, int solver, double *values, double *vectors) {
  const Parameters p = {constants};
  for (long start = 0; start < n; start += W) {
    real f[9], e[9], Q[9], U[9], V[9], d[81];
    load_points(F, n, start, f);
    eigenvalues_point(p, f, solver, e, Q, U, V);
    for (int k = 0; k < 9; ++k) eigenvector_point(k, Q, U, V, d + 9 * k);
    STORE(values, 9, e)
    STORE(vectors, 81, d)
  }
}
