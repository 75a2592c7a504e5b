/* One quadrature point: energy, stress and filtered Hessian of the generated material.
 *
 * What the code generator provides (kernels/codegen/):
 *   energy_invariants, stress_invariants ........ from F alone, if the energy needs no stretches
 *   energy_stretches, gradient_stretches ........ from the principal stretches
 *   hessian_stretches(p, s, A, twist, flip) ..... scaling block, twist and flip eigenvalues
 *   energy_near_rest, and factors_near_rest (no stretches) or gradient_near_rest: see small_strain.h
 * Outside the domain of psi, and where F is not finite, the energy is +inf and all else is 0; the same
 * goes for what overflows. Nothing is ever NaN. 9-vectors are vec(.) by columns (paper, eq. 17). */

enum { EXACT, CLAMP, ABS };

INLINE real filtered(int filter, real e) {
  return filter == CLAMP ? largest(e, splat(0)) : filter == ABS ? absolute(e) : e;
}

/* Whether F is so thin that det F from its cofactors may lose its digits, even its sign: products of
 * |F|^3 that cancel. The product of the stretches does not. */
INLINE mask thin(const real *F) {
  real C[9];
  cross(F + 3, F + 6, C);
  const real J = dot(F, C), squares = dot(F, F) + dot(F + 3, F + 3) + dot(F + 6, F + 6);
  const mask cancels = absolute(J) < 1e-3 * squares * lane_sqrt(squares);
  return HAS_VOLUME ? cancels : (mask){0};
}

/* The energy at F = I + H. Near rest it is that of H, elsewhere that of F. */
INLINE void energy_point(Law p, const real *F, const real *H, real *psi) {
  const mask near = near_rest(H);
  real close[1] = {splat(0)}, U[9], s[3], V[9], change[3];
  if (any(near)) {
#if NEEDS_STRETCHES
    svd_near_rest(H, U, s, change, V);
#else
    invariants_change(H, change);
#endif
    energy_near_rest(p, change, close);
    psi[0] = close[0];
  }
  if (!any(~near)) return;
#if NEEDS_STRETCHES
  svd(F, U, s, V);
  energy_stretches(p, s, psi);
#else
  energy_invariants(p, F, psi);
  const mask flat = thin(F);
  if (any(flat)) {
    real value[1];
    svd(F, U, s, V);
    energy_stretches(p, s, value);
    psi[0] = select(flat, value[0], psi[0]);
  }
#endif
  psi[0] = select(near, close[0], psi[0]);
}

/* P = sum_i g_i u_i v_i^T */
INLINE void compose(const real *g, const real *U, const real *V, real *P) {
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      P[3 * j + i] = g[0] * U[i] * V[j] + g[1] * U[3 + i] * V[3 + j] + g[2] * U[6 + i] * V[6 + j];
}

INLINE void stress_point(Law p, const real *F, const real *H, real *P) {
  const mask near = near_rest(H);
  real close[9], change[3];
  for (int i = 0; i < 9; ++i) close[i] = splat(0);
  if (any(near)) {
#if NEEDS_STRETCHES
    real U[9], V[9], s[3], g[3];
    svd_near_rest(H, U, s, change, V);
    gradient_near_rest(p, change, g);
    compose(g, U, V, close);
#else
    real factor[4];
    invariants_change(H, change);
    factors_near_rest(p, change, factor);
    stress_near_rest(H, factor[0], factor[1], factor[2], factor[3], close);
#endif
    for (int i = 0; i < 9; ++i) P[i] = close[i];
  }
  if (!any(~near)) return;
#if NEEDS_STRETCHES
  real U[9], V[9], s[3], g[3];
  svd(F, U, s, V);
  gradient_stretches(p, s, g);
  compose(g, U, V, P);
#else
  stress_invariants(p, F, P);
  const mask flat = thin(F);
  if (any(flat)) {
    real U[9], V[9], s[3], g[3], value[9];
    svd(F, U, s, V);
    gradient_stretches(p, s, g);
    compose(g, U, V, value);
    for (int i = 0; i < 9; ++i) P[i] = select(flat, value[i], P[i]);
  }
#endif
  for (int i = 0; i < 9; ++i) P[i] = select(near, close[i], P[i]);
}

/* The nine eigenvalues in the paper's order (scaling 0-2, twist 3-5, flip 6-8), the vectors Q of the
 * scaling block, and U, V: everything from which the eigenvectors of eq. 39 and 62 are made. */
INLINE void eigenvalues_point(Law p, const real *F, int solver, real *e, real *Q, real *U, real *V) {
  real s[3], A[6];
  svd(F, U, s, V);
  hessian_stretches(p, s, A, e + 3, e + 6);
  eigen3(solver, A, e, Q);
}

/* Eigenvector k as a 9-vector: U D_k V^T (paper, eq. 39, 62 and Appendix A). */
INLINE void eigenvector_point(int k, const real *Q, const real *U, const real *V, real *d) {
  if (k < 3) {
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i)
        d[3 * j + i] = Q[3 * k] * U[i] * V[j] + Q[3 * k + 1] * U[3 + i] * V[3 + j] + Q[3 * k + 2] * U[6 + i] * V[6 + j];
    return;
  }
  const int axis = k % 3, a = axis == 0, b = axis == 2 ? 1 : 2; /* the pair of stretches it couples */
  const double sign = k < 6 ? -1.0 : 1.0, r = 0.70710678118654752440;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      d[3 * j + i] = r * (U[3 * a + i] * V[3 * b + j] + sign * (U[3 * b + i] * V[3 * a + j]));
}

/* Replace the scaling block by its filtered self; true where it had a negative eigenvalue. Where
 * every lane is positive definite by its leading minors there is nothing to do. */
INLINE mask filter_block(int filter, int solver, real *A) {
  const real minor = A[0] * A[1] - A[3] * A[3];
  const real det = minor * A[2] - A[0] * A[5] * A[5] - A[1] * A[4] * A[4] + 2 * A[3] * A[4] * A[5];
  const mask positive = (A[0] > 0) & (A[1] > 0) & (A[2] > 0) & (minor > 1e-13 * A[0] * A[1]) &
                        (det > 1e-13 * A[0] * A[1] * A[2]);
  if (filter == EXACT || !any(~positive)) return ~positive;
  real e[3], Q[9];
  eigen3(solver, A, e, Q);
  real B[6] = {splat(0), splat(0), splat(0), splat(0), splat(0), splat(0)};
  for (int k = 0; k < 3; ++k) {
    const real value = filtered(filter, e[k]), *q = Q + 3 * k;
    for (int i = 0; i < 3; ++i) B[i] += value * q[i] * q[i];
    B[3] += value * q[0] * q[1];
    B[4] += value * q[0] * q[2];
    B[5] += value * q[1] * q[2];
  }
  /* A lane's result must not depend on its neighbours, which change with the number of ranks. */
  for (int i = 0; i < 6; ++i) A[i] = select(positive, A[i], B[i]);
  return ~positive & (e[2] < 0);
}

/* The 9x9 Hessian d2psi/dF2 (row-major) after the filter; true where an eigenvalue was negative.
 *
 * Written in the nine products u_a v_b^T: the scaling block couples u_i v_i^T, and each twist/flip
 * pair couples u_a v_b^T with u_b v_a^T, so no eigenvector has to be normalised. */
INLINE mask hessian_point(Law p, const real *F, int filter, int solver, real *C) {
  real U[9], V[9], s[3], A[6], twist[3], flip[3], o[9][9], y[9];
  svd(F, U, s, V);
  hessian_stretches(p, s, A, twist, flip);
  mask negative = filter_block(filter, solver, A);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 3; ++i) o[3 * a + b][3 * j + i] = U[3 * a + i] * V[3 * b + j];
  for (int i = 0; i < 81; ++i) C[i] = splat(0);
  const real S[9] = {A[0], A[3], A[4], A[3], A[1], A[5], A[4], A[5], A[2]};
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 9; ++i) y[i] = S[3 * k] * o[0][i] + S[3 * k + 1] * o[4][i] + S[3 * k + 2] * o[8][i];
    for (int i = 0; i < 9; ++i)
      for (int j = i; j < 9; ++j) C[9 * i + j] += y[i] * o[4 * k][j];
  }
  for (int k = 0; k < 3; ++k) {
    negative |= (twist[k] < 0) | (flip[k] < 0);
    const real t = filtered(filter, twist[k]), f = filtered(filter, flip[k]);
    const real same = (f + t) / 2, other = (f - t) / 2;
    const int a = k == 0, b = k == 2 ? 1 : 2; /* the two stretches that twist and flip k couple */
    for (int side = 0; side < 2; ++side) {
      const real *mine = side ? o[3 * b + a] : o[3 * a + b], *theirs = side ? o[3 * a + b] : o[3 * b + a];
      for (int i = 0; i < 9; ++i) y[i] = same * mine[i] + other * theirs[i];
      for (int i = 0; i < 9; ++i)
        for (int j = i; j < 9; ++j) C[9 * i + j] += y[i] * mine[j];
    }
  }
  for (int i = 1; i < 9; ++i)
    for (int j = 0; j < i; ++j) C[9 * i + j] = C[9 * j + i];
  return negative;
}
