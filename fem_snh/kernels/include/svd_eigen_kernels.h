/* Loops over points for svd_eigen_api.h, W points at a time. */

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
    eigen3(solver, a, value, vector);
    STORE(e, 3, value)
    STORE(Q, 9, vector)
  }
}
