/* Loops over points for pointwise_api.h, W points at a time. */

/* H = F - I; exact for F near I (Sterbenz). */
INLINE void subtract_identity(const real *F, real *H) {
  for (int i = 0; i < 9; ++i) H[i] = F[i] - (i % 4 == 0);
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
