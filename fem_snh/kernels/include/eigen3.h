/* Eigenpairs of symmetric 3x3 matrices A = {a00, a11, a22, a01, a02, a12}: eigenvalues e in descending
 * order, eigenvectors in the columns of Q (Q[3 k + i] is component i of vector k).
 *
 * Two eigensolvers (an enum that codegen/source.py generates from fem_snh.choices):
 *   CUBIC   the characteristic polynomial (Smith et al. 2018, eq. 33, 42 and 66), with deflation to a 2x2
 *           block, so that nearly equal eigenvalues keep their accuracy;
 *   JACOBI  cyclic Jacobi (Golub & Van Loan 2013, sec. 8.5).
 * Both have absolute errors of a few roundings of the norm of A, for every finite A. CUBIC is several
 * times faster; JACOBI also gives small eigenvalues of graded positive definite matrices to relative
 * accuracy (tests/kernels/test_eigen3.py, docs/results/eigensolver.md). */

/* B = A scaled by a power of two to a sum of absolute values in [1, 2); zero where A is not finite. */
INLINE void scale_block(const real *A, real *B, real *up) {
  real size = splat(0), down;
  for (int i = 0; i < 6; ++i) size += absolute(A[i]);
  const mask finite = size < INFINITY;
  power_of_two(size, up, &down);
  for (int i = 0; i < 6; ++i) B[i] = select(finite, A[i] * down, splat(0));
}

/* Exchange eigenpairs p and q if e[p] < e[q]. */
INLINE void order_pair(real *e, real *Q, int p, int q) {
  const mask swap = e[p] < e[q];
  const real a = e[p];
  e[p] = select(swap, e[q], a);
  e[q] = select(swap, a, e[q]);
  for (int i = 0; i < 3; ++i) {
    const real v = Q[3 * p + i];
    Q[3 * p + i] = select(swap, Q[3 * q + i], v);
    Q[3 * q + i] = select(swap, v, Q[3 * q + i]);
  }
}

/* One Jacobi rotation that makes apq zero; r is the third index, qp and qq are the columns of Q. Returns the lanes
 * where apq was not negligible, |apq| > 1e-16 sqrt|app aqq|: relative to the two diagonal entries, not to the norm
 * of A, so that small eigenvalues of a graded matrix keep their relative accuracy. */
INLINE mask rotate_pair(real *app, real *aqq, real *apq, real *arp, real *arq, real *qp, real *qq) {
  const mask turn = *apq * *apq > 1e-32 * absolute(*app * *aqq);
  if (!any(turn)) return turn;
  const real d = *aqq - *app;
  const real tangent = 2 * *apq / (absolute(d) + lane_sqrt(d * d + 4 * *apq * *apq));
  const real t = select(turn, select(d < 0, -tangent, tangent), splat(0));
  const real cosine = 1 / lane_sqrt(1 + t * t), sine = cosine * t;
  *app -= t * *apq;
  *aqq += t * *apq;
  *apq = select(turn, splat(0), *apq);
  const real rp = *arp;
  *arp = cosine * rp - sine * *arq;
  *arq = sine * rp + cosine * *arq;
  for (int i = 0; i < 3; ++i) {
    const real v = qp[i];
    qp[i] = cosine * v - sine * qq[i];
    qq[i] = sine * v + cosine * qq[i];
  }
  return turn;
}

INLINE void eigen3_jacobi(const real *A, real *e, real *Q) {
  real B[6], up;
  scale_block(A, B, &up);
  for (int i = 0; i < 9; ++i) Q[i] = splat(i % 4 == 0);
  for (int sweep = 0; sweep < 16; ++sweep) { /* a bound: five sweeps converge */
    mask turned = rotate_pair(&B[0], &B[1], &B[3], &B[4], &B[5], Q, Q + 3);
    turned |= rotate_pair(&B[0], &B[2], &B[4], &B[3], &B[5], Q, Q + 6);
    turned |= rotate_pair(&B[1], &B[2], &B[5], &B[3], &B[4], Q + 3, Q + 6);
    if (!any(turned)) break;
  }
  for (int k = 0; k < 3; ++k) e[k] = B[k] * up;
  order_pair(e, Q, 0, 1);
  order_pair(e, Q, 0, 2);
  order_pair(e, Q, 1, 2);
}

/* w^T A v. */
INLINE real bilinear(const real *A, const real *v, const real *w) {
  return (A[0] * v[0] + A[3] * v[1] + A[4] * v[2]) * w[0] + (A[3] * v[0] + A[1] * v[1] + A[5] * v[2]) * w[1] +
         (A[4] * v[0] + A[5] * v[1] + A[2] * v[2]) * w[2];
}

/* The unit eigenvector of the simple eigenvalue e of A: the longest cross product of two rows of A - e I. */
INLINE void null_vector(const real *A, real e, real *v) {
  const real r0[3] = {A[0] - e, A[3], A[4]}, r1[3] = {A[3], A[1] - e, A[5]}, r2[3] = {A[4], A[5], A[2] - e};
  real c[9], n[3];
  cross(r0, r1, c);
  cross(r0, r2, c + 3);
  cross(r1, r2, c + 6);
  for (int k = 0; k < 3; ++k) n[k] = dot(c + 3 * k, c + 3 * k);
  const mask first = (n[0] >= n[1]) & (n[0] >= n[2]), second = ~first & (n[1] >= n[2]);
  const real norm = lane_sqrt(select(first, n[0], select(second, n[1], n[2])));
  for (int i = 0; i < 3; ++i) v[i] = select(first, c[i], select(second, c[3 + i], c[6 + i])) / norm;
}

/* The characteristic cubic gives only the eigenvalue best separated from the other two, and its eigenvector v. The
 * other two eigenpairs come from the 2x2 block on the plane normal to v. (Equal roots of the cubic lose half of their
 * digits, and their eigenvectors all digits.) The computation is on N in A = mean I + p N, with tr N = 0 and
 * |N|_F = sqrt(6), so that eigenvalues keep their differences however large the mean is. */
INLINE void eigen3_cubic(const real *A, real *e, real *Q) {
  real N[6], up;
  scale_block(A, N, &up);
  const real mean = (N[0] + N[1] + N[2]) / 3;
  for (int k = 0; k < 3; ++k) N[k] -= mean;
  const real squares = N[0] * N[0] + N[1] * N[1] + N[2] * N[2] + 2 * dot(N + 3, N + 3);
  const mask sphere = squares == 0; /* A = mean I: N = 0, every vector is an eigenvector */
  const real p = lane_sqrt(squares / 6), over_p = 1 / select(sphere, splat(1), p);
  for (int i = 0; i < 6; ++i) N[i] *= over_p;

  /* The characteristic polynomial of N, y^3 - 3 y - det N = 0, has the root
   * y = 2 cos(acos(det N / 2) / 3) (Smith et al. 2018, eq. 33), in [sqrt 3, 2] for det N > 0.
   * Start: the chord from y(0) = sqrt 3 to y(2) = 2; three Newton steps reach double precision. */
  const real det = N[0] * (N[1] * N[2] - N[5] * N[5]) - N[3] * (N[3] * N[2] - N[5] * N[4]) + N[4] * (N[3] * N[5] - N[1] * N[4]);
  const mask top = det >= 0;
  const real r = lane_min(absolute(det), splat(2));
  real y = 1.7320508075688772 + 0.1339745962155614 * r;
  for (int step = 0; step < 3; ++step) y = (2 * y * y * y + r) / (3 * (y * y - 1));
  y = select(top, y, -y);

  real v[3], w[3], x[3];
  null_vector(N, y, v);
  const mask use_x = absolute(v[0]) < 0.7; /* < 1/sqrt 2: an axis that is not parallel to v */
  const real axis[3] = {select(use_x, splat(1), splat(0)), select(use_x, splat(0), splat(1)), splat(0)};
  cross(v, axis, w);
  const real length = lane_sqrt(dot(w, w));
  for (int i = 0; i < 3; ++i) w[i] /= length;
  cross(v, w, x);

  /* Diagonalise the 2x2 block on (w, x) by one rotation; the larger diagonal entry comes first. */
  const real half = (bilinear(N, w, w) - bilinear(N, x, x)) / 2, coupling = bilinear(N, w, x);
  const real radius = lane_sqrt(half * half + coupling * coupling), sum = absolute(half) + radius;
  const mask round = sum == 0, swap = half < 0;
  const real t = select(round, splat(0), coupling / sum);
  const real cosine = 1 / lane_sqrt(1 + t * t), sine = cosine * t;
  for (int i = 0; i < 3; ++i) {
    const real a = select(swap, x[i], w[i]), b = select(swap, w[i], x[i]);
    const real larger = cosine * a + sine * b, smaller = cosine * b - sine * a;
    Q[i] = select(top, v[i], larger);
    Q[3 + i] = select(top, larger, smaller);
    Q[6 + i] = select(top, smaller, v[i]);
  }
  const real more = radius - y / 2, less = -radius - y / 2;
  e[0] = (mean + p * select(top, y, more)) * up;
  e[1] = (mean + p * select(top, more, less)) * up;
  e[2] = (mean + p * select(top, less, y)) * up;
}

/* Eigenpairs by the eigensolver CUBIC or JACOBI. */
void eigen3(int solver, const real *A, real *e, real *Q) {
  if (solver == CUBIC)
    eigen3_cubic(A, e, Q);
  else
    eigen3_jacobi(A, e, Q);
}
