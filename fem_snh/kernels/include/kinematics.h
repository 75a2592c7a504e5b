/* The kinematics: how nodal values become the displacement gradient H (3x3, by columns, F = I + H).
 *
 * The code generator defines COMPONENTS, the displacement components of a node (2 or 3), and KINEMATICS:
 *   SOLID ....... H = sum_a u_a (grad N_a)^T
 *   PLANE ....... the same with d/dx_3 = 0: F_33 = 1
 *   REVOLVED .... the body of revolution of a half plane with coordinates (r, z) and components (u_r, u_z, u_theta)
 *                 in the basis (e_r, e_z, e_theta) of the reference position:
 *                 H's third column is (du/dtheta)/r = (-u_theta, 0, u_r)/r = S u/r
 * In all of them H is linear in the nodal values: column j of H is sum_a G_aj S_j u_a with S_0 = S_1 = I and, on a
 * body of revolution, S_2 = S and G_a2 = N_a/r. So with D = diag(S_0, S_1, S_2) the forces are those of a solid
 * with D^T vec(P), and the stiffness is that of a solid with D^T C D, positive semidefinite where C is. */
#define SOLID 0
#define PLANE 1
#define REVOLVED 2

/* v[NODES][3] = the nodal displacements of W cells. */
#if COMPONENTS == 3
#define GATHER_DISPLACEMENTS(v, map, u) GATHER(v, NODES, 3, map, u)
#else
#define GATHER_DISPLACEMENTS(v, map, u)          \
  GATHER(v, NODES, 2, map, u)                    \
  for (int a = 0; a < NODES; ++a) v[a][2] = splat(0);
#endif

/* The third column of T = dx/dxi (see geometry_point), whose third reference coordinate is x_3 or theta. The third
 * "derivatives" of the basis are zero on a plane, and the basis functions on a body of revolution: T + 6 is then
 * the point's (r, z, 0), and dx/dtheta has the length r. */
INLINE void third_tangent(real *T) {
#if KINEMATICS == PLANE
  T[8] = splat(1);
#elif KINEMATICS == REVOLVED
  T[8] = T[6];
  T[6] = T[7] = splat(0);
#endif
}

/* Replace sum_a G_a2 u_a, H's third column on a solid, by that of the kinematics. */
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
