/* The rotation-variant SVD F = U diag(s) V^T of 3x3 matrices (paper, eq. 2).
 *
 * U and V are rotations, s0 >= s1 >= |s2|, and a reflection makes s2 negative. One-sided Jacobi
 * (Hestenes): columns of F V are rotated until orthogonal. It never forms F^T F, so a small stretch
 * keeps the digits that F gives it. Matrices are stored by columns: M[3 j + i] is row i, column j.
 *
 * Any finite F will do: it is scaled by a power of two. Of stretches below 1e-75 of the largest only
 * the size is right. Where F is not finite s is NaN, and U and V are the identity. */

/* Rotate columns p and q of G (and of V along) so that they are orthogonal; true where they were not.
 * 4e-16 is what rounding leaves of the cosine of a right angle: below it there is no convergence. */
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

/* Put the longer of columns p, q first: a rotation by a right angle, so det V stays 1. */
INLINE void longer_first(real *G, real *V, int p, int q) {
  const mask swap = dot(G + 3 * p, G + 3 * p) < dot(G + 3 * q, G + 3 * q);
  for (int i = 0; i < 3; ++i) {
    const real g = G[3 * p + i], v = V[3 * p + i];
    G[3 * p + i] = select(swap, G[3 * q + i], g);
    G[3 * q + i] = select(swap, -g, G[3 * q + i]);
    V[3 * p + i] = select(swap, V[3 * q + i], v);
    V[3 * q + i] = select(swap, -v, V[3 * q + i]);
  }
}

/* v less its part along the unit vector u. */
INLINE void normal_part(const real *u, const real *v, real *n) {
  const real along = dot(u, v);
  for (int i = 0; i < 3; ++i) n[i] = v[i] - along * u[i];
}

/* s2, or 0 where it is rounding alone, and so its sign: below 2^-52 of every column's and row's size the
 * F whose columns (or rows) are scaled to the same size is singular to working precision. */
INLINE real without_noise(const real *F, real down, real s2) {
  real least = splat(INFINITY);
  for (int k = 0; k < 3; ++k) {
    least = smallest(least, absolute(F[3 * k]) + absolute(F[3 * k + 1]) + absolute(F[3 * k + 2]));
    least = smallest(least, absolute(F[k]) + absolute(F[3 + k]) + absolute(F[6 + k]));
  }
  return select(absolute(s2) <= 0x1p-52 * (least * down), splat(0), s2);
}

INLINE void svd(const real *F, real *U, real *s, real *V) {
  real G[9], size = splat(0), up, down;
  for (int i = 0; i < 9; ++i) size += absolute(F[i]);
  const mask finite = size < INFINITY;
  power_of_two(size, &up, &down);
  for (int i = 0; i < 9; ++i) {
    G[i] = select(finite, F[i] * down, splat(0));
    V[i] = splat(i % 4 == 0);
  }
  for (int sweep = 0; sweep < 16; ++sweep) { /* three to five suffice */
    mask turned = orthogonalise(G, V, 0, 1);
    turned |= orthogonalise(G, V, 0, 2);
    turned |= orthogonalise(G, V, 1, 2);
    if (!any(turned)) break;
  }
  longer_first(G, V, 0, 1);
  longer_first(G, V, 0, 2);
  longer_first(G, V, 1, 2);

  /* u0 along the longest column; u1 along the next, or any normal to u0 where that one vanishes. */
  real *u0 = U, *u1 = U + 3, *u2 = U + 6, next[3], normal[3];
  const real longest = lane_sqrt(dot(G, G));
  const mask point = longest == 0;
  for (int i = 0; i < 3; ++i)
    u0[i] = select(point, splat(i == 0), G[i] / select(point, splat(1), longest));

  const real x = absolute(u0[0]), y = absolute(u0[1]), z = absolute(u0[2]);
  const mask axis_x = (x <= y) & (x <= z), axis_y = ~axis_x & (y <= z);
  const real axis[3] = {select(axis_x, splat(1), splat(0)), select(axis_y, splat(1), splat(0)),
                        select(axis_x | axis_y, splat(0), splat(1))};
  real g1[3], big, small; /* the second column, its squares far from underflow */
  power_of_two(absolute(G[3]) + absolute(G[4]) + absolute(G[5]), &big, &small);
  for (int i = 0; i < 3; ++i) g1[i] = G[3 + i] * small;
  normal_part(u0, g1, next);
  normal_part(u0, axis, normal);
  const mask line = ~(dot(next, next) > 0.25 * dot(g1, g1));
  for (int i = 0; i < 3; ++i) u1[i] = select(line, normal[i], next[i]);
  const real length = lane_sqrt(dot(u1, u1));
  for (int i = 0; i < 3; ++i) u1[i] /= length;
  cross(u0, u1, u2);
  s[0] = select(finite, longest * up, splat(NAN));
  s[1] = select(finite, dot(u1, G + 3) * up, splat(NAN));
  real shortest = dot(u2, G + 6);
  if (any(absolute(shortest) <= 1e-15 * longest)) shortest = without_noise(F, down, shortest);
  s[2] = select(finite, shortest * up, splat(NAN));
}
