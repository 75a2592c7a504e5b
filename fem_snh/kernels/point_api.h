/* The kernels at n points of the caller, F[n][9] by columns: what Material's pointwise methods call. */

INLINE void load_points(const double *F, long n, long start, real *lanes) {
  for (int l = 0; l < W; ++l) {
    const long at = start + l < n ? start + l : n - 1;
    for (int i = 0; i < 9; ++i) lanes[i][l] = F[9 * at + i];
  }
}

#define STORE(out, size, lanes)                  \
  for (int l = 0; l < W && start + l < n; ++l)   \
    for (int i = 0; i < (size); ++i) (out)[(size) * (start + l) + i] = (lanes)[i][l];

void energy_points(const double *p, long n, const double *F, double *psi) {
  for (long start = 0; start < n; start += W) {
    real f[9], value[1];
    load_points(F, n, start, f);
    energy_point(p, f, value);
    STORE(psi, 1, value)
  }
}

void stress_points(const double *p, long n, const double *F, double *P) {
  for (long start = 0; start < n; start += W) {
    real f[9], stress[9];
    load_points(F, n, start, f);
    stress_point(p, f, stress);
    STORE(P, 9, stress)
  }
}

void hessian_points(const double *p, long n, const double *F, int filter, int solver, double *C) {
  for (long start = 0; start < n; start += W) {
    real f[9], c[81];
    load_points(F, n, start, f);
    hessian_point(p, f, filter, solver, c);
    STORE(C, 81, c)
  }
}

void eigensystem_points(const double *p, long n, const double *F, int solver, double *values, double *vectors) {
  for (long start = 0; start < n; start += W) {
    real f[9], e[9], Q[9], U[9], V[9], d[81];
    load_points(F, n, start, f);
    eigenvalues_point(p, f, solver, e, Q, U, V);
    for (int k = 0; k < 9; ++k) eigenvector_point(k, Q, U, V, d + 9 * k);
    STORE(values, 9, e)
    STORE(vectors, 81, d)
  }
}

void svd_points(long n, const double *F, double *U, double *s, double *V) {
  for (long start = 0; start < n; start += W) {
    real f[9], u[9], sigma[3], v[9];
    load_points(F, n, start, f);
    svd(f, u, sigma, v);
    STORE(U, 9, u)
    STORE(s, 3, sigma)
    STORE(V, 9, v)
  }
}

void eigen3_points(long n, const double *A, int solver, double *e, double *Q) {
  for (long start = 0; start < n; start += W) {
    real a[6], value[3], vector[9];
    for (int l = 0; l < W; ++l)
      for (int i = 0; i < 6; ++i) a[i][l] = A[6 * (start + l < n ? start + l : n - 1) + i];
    if (solver == CUBIC)
      eigen3_cubic(a, value, vector);
    else
      eigen3_jacobi(a, value, vector);
    STORE(e, 3, value)
    STORE(Q, 9, vector)
  }
}
