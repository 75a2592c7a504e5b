/* The rotation-variant SVD F = U diag(s) V^T of 3x3 matrices (Smith et al. 2018, eq. 2): U and V are
 * rotations, s0 >= s1 >= |s2|, and s2 < 0 if det F < 0.
 *
 * Method: one-sided Jacobi (Hestenes 1958): rotate the columns of F V until they are orthogonal. F^T F is
 * never formed, so small stretches keep their relative accuracy. Matrices are stored by columns:
 * M[3 j + i] is row i, column j.
 *
 * F is scaled by a power of two, so every finite F works. A stretch below 1e-75 of the largest one has
 * the right magnitude only. Where F is not finite, s is NaN and U = V = I. */

/* Rotate columns p and q of G (and of V) so that those of G become orthogonal. Returns the lanes where they
 * were not. The threshold is 1.6e-31 = 4e-16 squared: the computed cosine of a right angle is up to 4e-16 in
 * double precision. */
INLINE mask orthogonalise(real *G, real *V, int p, int q) {
  real *gp = G + 3 * p, *gq = G + 3 * q, *vp = V + 3 * p, *vq = V + 3 * q;
  const real a = dot(gp, gp), b = dot(gq, gq), c = dot(gp, gq), d = b - a;
  const mask turn = c * c > 1.6e-31 * a * b;
  if (!any(turn)) return turn;
  const real tangent = 2 * c / (absolute(d) + lane_sqrt(d * d + 4 * c * c));
  const real t = select(turn, select(d < 0, -tangent, tangent), splat(0));
  const real cosine = 1 / lane_sqrt(1 + t * t), sine = cosine * t;
  for (int i = 0; i < 3; ++i) {
    const real g = gp[i], v = vp[i];
    gp[i] = cosine * g - sine * gq[i];
    gq[i] = sine * g + cosine * gq[i];
    vp[i] = cosine * v - sine * vq[i];
    vq[i] = sine * v + cosine * vq[i];
  }
  return turn;
}

/* Exchange columns p and q of G and V if q of G is longer. One column changes sign, so that det V stays 1. */
INLINE void order_columns(real *G, real *V, int p, int q) {
  const mask swap = dot(G + 3 * p, G + 3 * p) < dot(G + 3 * q, G + 3 * q);
  for (int i = 0; i < 3; ++i) {
    const real g = G[3 * p + i], v = V[3 * p + i];
    G[3 * p + i] = select(swap, G[3 * q + i], g);
    G[3 * q + i] = select(swap, -g, G[3 * q + i]);
    V[3 * p + i] = select(swap, V[3 * q + i], v);
    V[3 * q + i] = select(swap, -v, V[3 * q + i]);
  }
}

/* n = v - (u . v) u for a unit vector u. */
INLINE void project_out(const real *u, const real *v, real *n) {
  const real along = dot(u, v);
  for (int i = 0; i < 3; ++i) n[i] = v[i] - along * u[i];
}

/* s2, or 0 where s2 and its sign are rounding errors. Where |s2| is below 2^-52 times the 1-norm of every column
 * and row, F is singular to working precision however its columns or rows are scaled. s2 is scaled by `down`. */
INLINE real drop_rounding(const real *F, real down, real s2) {
  real least = splat(INFINITY);
  for (int k = 0; k < 3; ++k) {
    least = lane_min(least, absolute(F[3 * k]) + absolute(F[3 * k + 1]) + absolute(F[3 * k + 2]));
    least = lane_min(least, absolute(F[k]) + absolute(F[3 + k]) + absolute(F[6 + k]));
  }
  return select(absolute(s2) <= 0x1p-52 * (least * down), splat(0), s2);
}

void svd(const real *F, real *U, real *s, real *V) {
  real G[9], size = splat(0), up, down;
  for (int i = 0; i < 9; ++i) size += absolute(F[i]);
  const mask finite = size < INFINITY;
  power_of_two(size, &up, &down);
  for (int i = 0; i < 9; ++i) {
    G[i] = select(finite, F[i] * down, splat(0));
    V[i] = splat(i % 4 == 0);
  }
  for (int sweep = 0; sweep < 16; ++sweep) { /* a bound: three to five sweeps converge */
    mask turned = orthogonalise(G, V, 0, 1);
    turned |= orthogonalise(G, V, 0, 2);
    turned |= orthogonalise(G, V, 1, 2);
    if (!any(turned)) break;
  }
  order_columns(G, V, 0, 1);
  order_columns(G, V, 0, 2);
  order_columns(G, V, 1, 2);

  /* u0 is parallel to the longest column; u1 to the second, or any normal of u0 where that vanishes. */
  real *u0 = U, *u1 = U + 3, *u2 = U + 6, next[3], normal[3];
  const real longest = lane_sqrt(dot(G, G));
  const mask zero = longest == 0;
  for (int i = 0; i < 3; ++i)
    u0[i] = select(zero, splat(i == 0), G[i] / select(zero, splat(1), longest));

  const real x = absolute(u0[0]), y = absolute(u0[1]), z = absolute(u0[2]);
  const mask axis_x = (x <= y) & (x <= z), axis_y = ~axis_x & (y <= z);
  const real axis[3] = {select(axis_x, splat(1), splat(0)), select(axis_y, splat(1), splat(0)),
                        select(axis_x | axis_y, splat(0), splat(1))};
  real g1[3], big, small; /* the second column, scaled so that its squares do not underflow */
  power_of_two(absolute(G[3]) + absolute(G[4]) + absolute(G[5]), &big, &small);
  for (int i = 0; i < 3; ++i) g1[i] = G[3 + i] * small;
  project_out(u0, g1, next);
  project_out(u0, axis, normal);
  const mask rank_one = ~(dot(next, next) > 0.25 * dot(g1, g1));
  for (int i = 0; i < 3; ++i) u1[i] = select(rank_one, normal[i], next[i]);
  const real length = lane_sqrt(dot(u1, u1));
  for (int i = 0; i < 3; ++i) u1[i] /= length;
  cross(u0, u1, u2);
  s[0] = select(finite, longest * up, splat(NAN));
  s[1] = select(finite, dot(u1, G + 3) * up, splat(NAN));
  real shortest = dot(u2, G + 6);
  if (any(absolute(shortest) <= 1e-15 * longest)) shortest = drop_rounding(F, down, shortest);
  s[2] = select(finite, shortest * up, splat(NAN));
}
