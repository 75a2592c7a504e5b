/* One quadrature point (W of them in lanes): the energy density, stress and filtered Hessian of a material that
 * material_functions.h declares.
 *
 * The generated functions (kernels/codegen/) called here:
 *   energy_invariants, stress_invariants ..... from F; only if the energy needs no principal stretches
 *   energy_stretches, gradient_stretches ..... psi and principal stresses dpsi/ds_i from the stretches
 *   hessian_stretches(p, s, A, twist, flip) .. the scaling block A and the twist and flip eigenvalues
 *   energy_small_strain, and stress_factors_small_strain (no stretches) or gradient_small_strain
 * Outside the domain of psi, where F is not finite and where a result overflows, the energy is +inf and
 * stress and Hessian are 0: no result is NaN. 9-vectors are vec(.) by columns (Smith et al. 2018, eq. 17). */

/* Loops over the entries of vec(F) that vary in an element's kinematics: the list ENTRIES, or all nine. */
#ifdef ENTRIES
static const int entries[] = {ENTRIES};
#define NUM_ENTRIES ((int)(sizeof entries / sizeof *entries))
#define ENTRY(m) entries[m]
#else
#define NUM_ENTRIES 9
#define ENTRY(m) (m)
#endif
#define FOR_ENTRIES(first, i) for (int i##_ = first, i; i##_ < NUM_ENTRIES && (i = ENTRY(i##_), 1); ++i##_)
#define FOR_UPPER_ENTRIES(i, j) FOR_ENTRIES(0, i) FOR_ENTRIES(i##_, j)

/* Lanes where F is nearly singular: |det F| < 1e-3 |F|^3, where cancellation in the cofactor formula of
 * det F loses digits or the sign. The product of the stretches of the SVD does not cancel. */
INLINE mask nearly_singular(const real *F) {
  real C[9];
  cross(F + 3, F + 6, C);
  const real J = dot(F, C), squares = dot(F, F) + dot(F + 3, F + 3) + dot(F + 6, F + 6);
  const mask cancels = absolute(J) < 1e-3 * squares * lane_sqrt(squares);
  return USES_J ? cancels : (mask){0};
}

/* psi at F = I + H [Pa]. Lanes of small strain use H, the others F. */
void energy_point(Parameters p, const real *F, const real *H, real *psi) {
  const mask small = small_strain(H);
  real small_psi[1] = {splat(0)}, U[9], s[3], V[9], change[3];
  if (any(small)) {
#if NEEDS_STRETCHES
    small_strain_svd(H, U, s, change, V);
#else
    invariant_increments(H, change);
#endif
    energy_small_strain(p, change, small_psi);
    psi[0] = small_psi[0];
  }
  if (!any(~small)) return;
#if NEEDS_STRETCHES
  svd(F, U, s, V);
  energy_stretches(p, s, psi);
#else
  energy_invariants(p, F, psi);
  const mask singular = nearly_singular(F);
  if (any(singular)) {
    real value[1];
    svd(F, U, s, V);
    energy_stretches(p, s, value);
    psi[0] = select(singular, value[0], psi[0]);
  }
#endif
  psi[0] = select(small, small_psi[0], psi[0]);
}

/* P = sum_i g_i u_i v_i^T from the principal stresses g. */
INLINE void compose_stress(const real *g, const real *U, const real *V, real *P) {
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      P[3 * j + i] = g[0] * U[i] * V[j] + g[1] * U[3 + i] * V[3 + j] + g[2] * U[6 + i] * V[6 + j];
}

/* The first Piola-Kirchhoff stress P = dpsi/dF [Pa] at F = I + H. */
void stress_point(Parameters p, const real *F, const real *H, real *P) {
  const mask small = small_strain(H);
  real small_P[9], change[3];
  for (int i = 0; i < 9; ++i) small_P[i] = splat(0);
  if (any(small)) {
#if NEEDS_STRETCHES
    real U[9], V[9], s[3], g[3];
    small_strain_svd(H, U, s, change, V);
    gradient_small_strain(p, change, g);
    compose_stress(g, U, V, small_P);
#else
    real factor[4];
    invariant_increments(H, change);
    stress_factors_small_strain(p, change, factor);
    small_strain_stress(H, factor[0], factor[1], factor[2], factor[3], small_P);
#endif
    for (int i = 0; i < 9; ++i) P[i] = small_P[i];
  }
  if (!any(~small)) return;
#if NEEDS_STRETCHES
  real U[9], V[9], s[3], g[3];
  svd(F, U, s, V);
  gradient_stretches(p, s, g);
  compose_stress(g, U, V, P);
#else
  stress_invariants(p, F, P);
  const mask singular = nearly_singular(F);
  if (any(singular)) {
    real U[9], V[9], s[3], g[3], value[9];
    svd(F, U, s, V);
    gradient_stretches(p, s, g);
    compose_stress(g, U, V, value);
    for (int i = 0; i < 9; ++i) P[i] = select(singular, value[i], P[i]);
  }
#endif
  for (int i = 0; i < 9; ++i) P[i] = select(small, small_P[i], P[i]);
}

/* The nine eigenvalues e of d2psi/dF2 in the order scaling 0-2, twist 3-5, flip 6-8, the eigenvectors Q of
 * the scaling block, and U, V: together they determine the eigenvectors (Smith et al. 2018, eq. 39, 62). */
void eigenvalues_point(Parameters p, const real *F, int solver, real *e, real *Q, real *U, real *V) {
  real s[3], A[6];
  svd(F, U, s, V);
  hessian_stretches(p, s, A, e + 3, e + 6);
  eigen3(solver, A, e, Q);
}

/* Sylvester's criterion for the scaling block A, with a margin of 1e-13 relative to the diagonal for the
 * rounding of the minors: `positive` where all leading minors are positive, `indefinite` where a minor is
 * negative. Neither is true where A is nearly singular. */
INLINE void leading_minors_test(const real *A, mask *positive, mask *indefinite) {
  const real minor = A[0] * A[1] - A[3] * A[3];
  const real det = minor * A[2] - A[0] * A[5] * A[5] - A[1] * A[4] * A[4] + 2 * A[3] * A[4] * A[5];
  const real minor_error = 1e-13 * A[0] * A[1], det_error = 1e-13 * A[0] * A[1] * A[2];
  *positive = (A[0] > 0) & (A[1] > 0) & (A[2] > 0) & (minor > minor_error) & (det > det_error);
  *indefinite = (A[0] < 0) | (A[1] < 0) | (A[2] < 0) | (minor < -absolute(minor_error)) | (det < -absolute(det_error));
}

/* Filter the eigenvalues of the scaling block A in place. Returns the lanes where A had a negative eigenvalue. A is
 * not changed in lanes where it is positive definite. */
INLINE mask filter_scaling_block(int filter, int solver, real *A) {
  mask positive, indefinite;
  leading_minors_test(A, &positive, &indefinite);
  /* EXACT needs the sign of an eigenvalue only: the minors give it, unless A is nearly singular. */
  if (!any(filter == EXACT ? ~(positive | indefinite) : ~positive)) return ~positive;
  real e[3], Q[9];
  eigen3(solver, A, e, Q);
  if (filter == EXACT) return ~positive & (indefinite | (e[2] < 0));
  real B[6] = {splat(0), splat(0), splat(0), splat(0), splat(0), splat(0)};
  for (int k = 0; k < 3; ++k) {
    const real value = filter_eigenvalue(filter, e[k]), *q = Q + 3 * k;
    for (int i = 0; i < 3; ++i) B[i] += value * q[i] * q[i];
    B[3] += value * q[0] * q[1];
    B[4] += value * q[0] * q[2];
    B[5] += value * q[1] * q[2];
  }
  /* A lane's result must not depend on its neighbours, which change with the number of ranks. */
  for (int i = 0; i < 6; ++i) A[i] = select(positive, A[i], B[i]);
  return ~positive & (e[2] < 0);
}

/* Remove the spin from the block {{same[0], other}, {other, same[1]}} of a twist/flip pair on u_a v_b^T, u_b v_a^T. A
 * spin changes F by W F with a skew W, here along (s_b, -s_a). The block's value along (s_a, s_b) remains. */
INLINE void objective_pair(real sa, real sb, real *same, real *other) {
  const real squares = sa * sa + sb * sb, value = same[0] + 2 * *other * sa * sb / squares;
  const mask spins = squares > 0;
  same[0] = select(spins, value * sa * sa / squares, same[0]);
  same[1] = select(spins, value * sb * sb / squares, same[1]);
  *other = select(spins, value * sa * sb / squares, *other);
}

/* The filtered 9x9 Hessian C of psi (row-major, on vec(F)) [Pa]. Returns the lanes where the exact Hessian
 * has a negative eigenvalue. Rows and columns that are not in ENTRIES are zero.
 *
 * C is assembled in the basis of the nine products u_a v_b^T: the scaling block couples u_i v_i^T, and each
 * twist/flip pair couples u_a v_b^T with u_b v_a^T, so the eigenvectors of these pairs are not needed. */
mask hessian_point(Parameters p, const real *F, int filter, int solver, real *C) {
  real U[9], V[9], s[3], A[6], twist[3], flip[3], o[9][9], y[9];
  svd(F, U, s, V);
  hessian_stretches(p, s, A, twist, flip);
  mask negative = filter_scaling_block(filter, solver, A);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      FOR_ENTRIES(0, i) o[3 * a + b][i] = U[3 * a + i % 3] * V[3 * b + i / 3];
  for (int i = 0; i < 81; ++i) C[i] = splat(0);
  const real S[9] = {A[0], A[3], A[4], A[3], A[1], A[5], A[4], A[5], A[2]};
  for (int k = 0; k < 3; ++k) {
    FOR_ENTRIES(0, i) y[i] = S[3 * k] * o[0][i] + S[3 * k + 1] * o[4][i] + S[3 * k + 2] * o[8][i];
    FOR_UPPER_ENTRIES(i, j) C[9 * i + j] += y[i] * o[4 * k][j];
  }
  for (int k = 0; k < 3; ++k) {
    negative |= (twist[k] < 0) | (flip[k] < 0);
    const real t = filter_eigenvalue(filter, twist[k]), f = filter_eigenvalue(filter, flip[k]);
    real same[2] = {(f + t) / 2, (f + t) / 2}, other = (f - t) / 2; /* the 2x2 block of the pair */
    const int a = k == 0, b = k == 2 ? 1 : 2; /* the stretches that twist k and flip k couple */
    if (filter == OBJECTIVE) objective_pair(s[a], s[b], same, &other);
    for (int side = 0; side < 2; ++side) {
      const real *mine = side ? o[3 * b + a] : o[3 * a + b], *theirs = side ? o[3 * a + b] : o[3 * b + a];
      FOR_ENTRIES(0, i) y[i] = same[side] * mine[i] + other * theirs[i];
      FOR_UPPER_ENTRIES(i, j) C[9 * i + j] += y[i] * mine[j];
    }
  }
  FOR_UPPER_ENTRIES(i, j) C[9 * j + i] = C[9 * i + j];
  return negative;
}
