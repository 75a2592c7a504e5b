/* Eigenpairs of symmetric 3x3 matrices A = {a00, a11, a22, a01, a02, a12}: values e in descending
 * order, vectors in the columns of Q (Q[3 k + i] is component i of vector k).
 *
 * Two ways: cyclic Jacobi (the default: accurate for every matrix) and the paper's cubic (eq. 42 and
 * 66: the characteristic polynomial of the scaling block, solved as in eq. 33). tests/test_eigen3.py
 * compares them; docs/eigensolver.md holds the table. */

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

INLINE void order_descending(real *e, real *Q) {
  order_pair(e, Q, 0, 1);
  order_pair(e, Q, 0, 2);
  order_pair(e, Q, 1, 2);
}

/* One Jacobi rotation that zeroes apq; r is the third index. True where it was not yet zero. */
INLINE mask rotate_pair(real *app, real *aqq, real *apq, real *arp, real *arq, real *qp, real *qq) {
  const mask turn = absolute(*apq) > 1e-16 * lane_sqrt(absolute(*app)) * lane_sqrt(absolute(*aqq));
  const real theta = (*aqq - *app) / select(turn, 2 * *apq, splat(1));
  real t = 1 / (absolute(theta) + lane_sqrt(1 + theta * theta));
  t = select(turn, select(theta < 0, -t, t), splat(0));
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
  real a01 = A[3], a02 = A[4], a12 = A[5];
  for (int k = 0; k < 3; ++k) e[k] = A[k];
  for (int i = 0; i < 9; ++i) Q[i] = splat(i % 4 == 0);
  for (int sweep = 0; sweep < 16; ++sweep) {
    mask turned = rotate_pair(&e[0], &e[1], &a01, &a02, &a12, Q, Q + 3);
    turned |= rotate_pair(&e[0], &e[2], &a02, &a01, &a12, Q, Q + 6);
    turned |= rotate_pair(&e[1], &e[2], &a12, &a01, &a02, Q + 3, Q + 6);
    if (!any(turned)) break;
  }
  order_descending(e, Q);
}

/* A unit vector that A - e I maps to zero: the longest cross product of two of its rows. False where
 * all three vanish (a repeated eigenvalue: any vector will do). */
INLINE mask null_vector(const real *A, real e, real scale, real *v) {
  const real r0[3] = {A[0] - e, A[3], A[4]}, r1[3] = {A[3], A[1] - e, A[5]}, r2[3] = {A[4], A[5], A[2] - e};
  real c[9], n[3];
  cross(r0, r1, c);
  cross(r0, r2, c + 3);
  cross(r1, r2, c + 6);
  for (int k = 0; k < 3; ++k) n[k] = dot(c + 3 * k, c + 3 * k);
  const mask first = (n[0] >= n[1]) & (n[0] >= n[2]), second = ~first & (n[1] >= n[2]);
  const real norm = lane_sqrt(select(first, n[0], select(second, n[1], n[2])));
  const mask found = norm > 1e-14 * scale * scale;
  for (int i = 0; i < 3; ++i)
    v[i] = select(first, c[i], select(second, c[3 + i], c[6 + i])) / select(found, norm, splat(1));
  return found;
}

INLINE void eigen3_cubic(const real *A, real *e, real *Q) {
  const real mean = (A[0] + A[1] + A[2]) / 3;
  const real b0 = A[0] - mean, b1 = A[1] - mean, b2 = A[2] - mean;
  const real off = A[3] * A[3] + A[4] * A[4] + A[5] * A[5];
  const real p = lane_sqrt((b0 * b0 + b1 * b1 + b2 * b2 + 2 * off) / 6);
  const mask sphere = p == 0;
  const real d = select(sphere, splat(1), p);
  const real det = b0 * (b1 * b2 - A[5] * A[5]) - A[3] * (A[3] * b2 - A[5] * A[4]) + A[4] * (A[3] * A[5] - b1 * A[4]);
  const real third = lane_acos(largest(splat(-1), smallest(splat(1), det / (2 * d * d * d)))) / 3;
  e[0] = mean + 2 * p * lane_cos(third);
  e[2] = mean + 2 * p * lane_cos(third + 2.0943951023931953);
  e[1] = 3 * mean - e[0] - e[2];

  /* The best separated eigenvalue first; the other two vectors in the plane normal to its own. */
  const mask top = (e[0] - e[1]) >= (e[1] - e[2]);
  real v[3], w[3], x[3];
  const real scale = absolute(mean) + p;
  const mask found = null_vector(A, select(top, e[0], e[2]), scale, v);
  for (int i = 0; i < 3; ++i) v[i] = select(found, v[i], splat(i == 0));
  const mask use_x = absolute(v[0]) < 0.7;
  const real axis[3] = {select(use_x, splat(1), splat(0)), select(use_x, splat(0), splat(1)), splat(0)};
  cross(v, axis, w);
  const real length = lane_sqrt(dot(w, w));
  for (int i = 0; i < 3; ++i) w[i] /= length;
  cross(v, w, x);
  const real Aw[3] = {A[0] * w[0] + A[3] * w[1] + A[4] * w[2], A[3] * w[0] + A[1] * w[1] + A[5] * w[2],
                      A[4] * w[0] + A[5] * w[1] + A[2] * w[2]};
  const real Ax[3] = {A[0] * x[0] + A[3] * x[1] + A[4] * x[2], A[3] * x[0] + A[1] * x[1] + A[5] * x[2],
                      A[4] * x[0] + A[5] * x[1] + A[2] * x[2]};
  /* Turn (w, x) by the angle that diagonalises the 2x2 block; its first vector has the larger value. */
  const real half = (dot(w, Aw) - dot(x, Ax)) / 2, coupling = dot(w, Ax);
  const real radius = lane_sqrt(half * half + coupling * coupling);
  const mask round = radius == 0;
  const real cosine2 = select(round, splat(1), half / select(round, splat(1), radius));
  const real cosine = lane_sqrt(largest(splat(0), (1 + cosine2) / 2));
  const real sine_abs = lane_sqrt(largest(splat(0), (1 - cosine2) / 2));
  const real sine = select(coupling < 0, -sine_abs, sine_abs);
  for (int i = 0; i < 3; ++i) {
    const real larger = cosine * w[i] + sine * x[i], smaller = cosine * x[i] - sine * w[i];
    Q[i] = select(top, v[i], larger);
    Q[3 + i] = select(top, larger, smaller);
    Q[6 + i] = select(top, smaller, v[i]);
  }
}
