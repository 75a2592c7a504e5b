/* The kinematics: how nodal values become the displacement gradient H (3x3, by columns, F = I + H).
 *
 * The program defines COMPONENTS, the displacement components of a node (2 or 3), and KINEMATICS:
 *   SOLID ....... H = sum_a u_a (grad N_a)^T
 *   PLANE ....... the same with d/dx_3 = 0: F_33 = 1
 *   PLANE_STRESS  PLANE with the F_33 > 0 at which P_33 = 0 (third_stretch)
 *   REVOLVED .... the body of revolution of a half plane with coordinates (r, z) and components (u_r, u_z, u_theta)
 *                 in the basis (e_r, e_z, e_theta) of the reference position:
 *                 H's third column is (du/dtheta)/r = (-u_theta, 0, u_r)/r = S u/r
 * Apart from F_33 in plane stress, H is linear in the nodal values: column j of H is sum_a G_aj S_j u_a with
 * S_0 = S_1 = I and, on a body of revolution, S_2 = S and G_a2 = N_a/r. So with D = diag(S_0, S_1, S_2) the forces are
 * computed as in a solid from D^T vec(P), and the stiffness from D^T C D, positive semidefinite where C is. */
#define SOLID 0
#define PLANE 1
#define REVOLVED 2
#define PLANE_STRESS 3

/* The number of basis gradients G_aj, j < DERIVATIVES, that are not zero, and the code of the third. */
#if KINEMATICS == PLANE || KINEMATICS == PLANE_STRESS
#define DERIVATIVES 2
#define THIRD(...)
#else
#define DERIVATIVES 3
#define THIRD(...) __VA_ARGS__
#endif

/* v[NODES][3] = the nodal displacements of W cells. */
#if COMPONENTS == 3
#define GATHER_DISPLACEMENTS(v, map, u) GATHER(v, NODES, 3, map, u)
#else
#define GATHER_DISPLACEMENTS(v, map, u)          \
  GATHER(v, NODES, 2, map, u)                    \
  for (int a = 0; a < NODES; ++a) v[a][2] = splat(0);
#endif

/* Set the third column of T = dx/dxi (see geometry_point); the third reference coordinate is x_3 or theta. The third
 * "derivatives" of the basis are zero on a plane; on a body of revolution they are the basis functions, so T + 6 is the
 * point's (r, z, 0), and dx/dtheta has the length r. */
INLINE void third_tangent(real *T) {
#if KINEMATICS == PLANE || KINEMATICS == PLANE_STRESS
  T[8] = splat(1);
#elif KINEMATICS == REVOLVED
  T[8] = T[6];
  T[6] = T[7] = splat(0);
#endif
}

/* Replace sum_a G_a2 u_a, the third column of H in a solid, by the third column in a body of revolution. */
INLINE void third_column(real *H) {
#if KINEMATICS == REVOLVED
  const real u_r = H[6];
  H[6] = -H[8];
  H[7] = splat(0);
  H[8] = u_r;
#endif
}

/* Replace a 9-vector y, a derivative in F, by D^T y. */
INLINE void pull_back(real *y) {
#if KINEMATICS == REVOLVED
  const real r_theta = y[6];
  y[6] = y[8];
  y[7] = splat(0);
  y[8] = -r_theta;
#endif
}

/* Replace the symmetric 9x9 matrix C by D^T C D. */
INLINE void pull_back_matrix(real *C) {
#if KINEMATICS == REVOLVED
  for (int i = 0; i < 9; ++i) pull_back(C + 9 * i);
  for (int j = 0; j < 9; ++j) {
    const real r_theta = C[54 + j];
    C[54 + j] = C[72 + j];
    C[63 + j] = splat(0);
    C[72 + j] = -r_theta;
  }
#endif
}

#if KINEMATICS == PLANE_STRESS
/* The smallest and largest F_33: the energy is minimised between them. */
#define THINNEST 1e-3
#define THICKEST 1e3

/* Set H_33 and F_33 to the minimum of psi in F_33 that continues the minimum at rest: P_33 = 0, or F_33 is one of the
 * bounds (a cell that is turned over in its plane has no root in F_33 > 0).
 *
 * Method: secants in a bracket P_33(lower) < 0 < P_33(upper), which grows from F_33 = 1. A step that leaves the
 * bracket is replaced by the geometric mean of the bracket's ends; so is, after eight steps, every third step if the
 * last three did not halve the bracket. A converged lane does not change, so its result is independent of other lanes. */
SHARED void third_stretch(const Parameters *p, real *F, real *H) {
  real P[9], size = splat(0);
  for (int i = 0; i < 9; ++i) size = i == 8 ? size : lane_max(size, absolute(H[i]));
  const real lowest = splat(THINNEST - 1), highest = splat(THICKEST - 1);
  real lower = lowest, upper = highest, width = splat(INFINITY), h = splat(0), before, slope_h;
  mask known_lower = (mask){0}, known_upper = (mask){0}, done = size == 0; /* at rest F_33 = 1 */
  H[8] = h;
  F[8] = 1 + h;
  stress_point(*p, F, H, P);
  real value = P[8];
  before = value;
  slope_h = h;
  done |= value == 0;
  /* The second point: H_33 = -(H_11 + H_22)/2, at small strain exact for nu = 1/3; if that is almost zero, an eighth
   * of the largest |H_ij|, downhill. */
  real next = -0.5 * (H[0] + H[4]);
  next = select(absolute(next) < 0.125 * size, select(value > 0, -0.125 * size, 0.125 * size), next);
  for (int step = 0; step < 100 && any(~done); ++step) {
    /* The bracket with the last value; then the next point within it. */
    const mask below = ~done & (value < 0), above = ~done & (value > 0);
    lower = select(below & (h > lower), h, lower);
    upper = select(above & (h < upper), h, upper);
    known_lower |= below;
    known_upper |= above;
    const real ends = (1 + upper) / (1 + lower);
    const mask slow = (step > 8 && step % 3 == 2 ? ~(mask){0} : (mask){0}) & (ends - 1 > 0.5 * width);
    if (step % 3 == 2) width = ends - 1;
    real middle = lane_sqrt((1 + lower) * (1 + upper)) - 1;
    middle = select(known_upper, middle, 2 * (1 + h) - 1); /* the bracket is open: double or halve F_33 */
    middle = select(known_lower, middle, select(known_upper, 0.5 * (1 + upper) - 1, middle));
    const mask inside = (next > lower) & (next < upper) & ~slow;
    next = select(inside, next, middle);
    next = lane_max(lowest, lane_min(highest, next));
    next = select(done, h, next);
    const real change = absolute(next - h);
    slope_h = select(done, slope_h, h);
    before = select(done, before, value);
    h = next;
    H[8] = h;
    F[8] = 1 + h;
    stress_point(*p, F, H, P);
    value = select(done, value, P[8]);
    const real scale = lane_max(size, absolute(h));
    done |= (value == 0) | (change <= 4e-15 * scale);
    done |= (h == lowest) & (value > 0);
    done |= (h == highest) & (value < 0);
    const real slope = (value - before) / (h - slope_h);
    next = h - value / slope; /* if not finite or out of the bracket, the middle replaces it */
  }
}

/* Where F_33 is not a bound, replace C by its Schur complement in F_33, the second derivative of the minimum. The Schur
 * complement is positive semidefinite where C is. */
INLINE void condense(const real *F, real *C) {
  const real pivot = C[80];
  const mask free = (F[8] > THINNEST) & (F[8] < THICKEST) & (pivot > 0);
  const real inverse = select(free, 1 / select(free, pivot, splat(1)), splat(0));
  for (int i = 0; i < 8; ++i)
    for (int j = 0; j < 8; ++j) C[9 * i + j] -= C[9 * i + 8] * C[72 + j] * inverse;
}
#define THIRD_STRETCH(p, F, H) third_stretch(&(p), F, H);
#define CONDENSE(F, C) condense(F, C);
#else
#define THIRD_STRETCH(p, F, H)
#define CONDENSE(F, C)
#endif
