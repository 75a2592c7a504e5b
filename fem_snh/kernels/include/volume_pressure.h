/* P2P1, Q2Q1: Taylor-Hood elements (Taylor & Hood 1973) with a continuous unknown pressure p.
 *
 * The energy density is psi' + p J - U*(p), where U* is the convex conjugate of the volume term U; it is
 * stationary in p where J = d(U*)/dp. The Jacobian is that of a saddle-point problem:
 *   [ H   B^T ]   B = integral of N dJ/du,  C = integral of N N^T d2(U*)/dp2,
 *   [ B   -C  ]   N the basis of the pressure; C = 0 at nu = 0.5.
 *
 * The code generator provides volume_conjugate(p, {U*, d(U*)/dp - 1, d2(U*)/dp2}): the volume ratio d(U*)/dp
 * is 1 at p = 0, and its increment is as accurate as the increment J - 1.
 *
 * With damping, p is the sum of an elastic pressure p_e = (p + s w) / (1 + s), which determines the volume ratio, and
 * a viscous pressure s (p_e - w): (1 + s) U*(p_e) replaces U*(p). */

typedef struct {
  real p[PRESSURE_NODES][1], w[PRESSURE_NODES][1]; /* nodal pressures, and the w of damping */
  real r[PRESSURE_NODES];     /* residual of the pressure equations */
  real B[NODES][3][PRESSURE_NODES], C[PRESSURE_NODES][PRESSURE_NODES]; /* B^T and C */
} VolumeTerm;

INLINE void volume_prepare(const Cells *c, real fraction, const long *cell, const real x[][3], const real v[][3], const double *pressure, VolumeTerm *m) {
  *m = (VolumeTerm){0};
  GATHER(m->p, PRESSURE_NODES, 1, c->pressure_nodes, pressure)
  if (c->pressure_damping) { GATHER(m->w, PRESSURE_NODES, 1, c->pressure_nodes, c->pressure_origin) }
}

INLINE Parameters volume_parameters(const Cells *c, const VolumeTerm *m, int q) {
  Parameters p = {c->constants, splat(0)};
  for (int a = 0; a < PRESSURE_NODES; ++a) p.pressure += m->p[a][0] * c->pressure_basis[PRESSURE_NODES * q + a];
  return p;
}

/* conjugate = {(1 + s) U*(p_e), its derivative by p minus 1, its second derivative by p}. */
INLINE void conjugate_point(const Cells *c, const VolumeTerm *m, int q, Parameters p, real *conjugate) {
  const double factor = 1 + c->pressure_damping;
  if (c->pressure_damping) {
    for (int a = 0; a < PRESSURE_NODES; ++a)
      p.pressure += m->w[a][0] * (c->pressure_damping * c->pressure_basis[PRESSURE_NODES * q + a]);
    p.pressure /= factor;
  }
  volume_conjugate(p, conjugate);
  conjugate[0] *= factor;
  conjugate[2] /= factor;
}

INLINE real volume_energy_density(const Cells *c, int q, Parameters p, const VolumeTerm *m, const real *F) {
  real conjugate[3];
  conjugate_point(c, m, q, p, conjugate);
  return -conjugate[0];
}

INLINE void volume_residual_point(const Cells *c, VolumeTerm *m, int q, Parameters p, const real *F, const real *H, real weight) {
  real conjugate[3], cofactor[9];
  conjugate_point(c, m, q, p, conjugate);
  const real J = determinant(F, cofactor), change = select(small_strain(H), volume_increment(H, cofactor), J - 1);
  const real mismatch = (change - conjugate[1]) * weight;
  for (int a = 0; a < PRESSURE_NODES; ++a) m->r[a] += c->pressure_basis[PRESSURE_NODES * q + a] * mismatch;
}

INLINE void volume_residual_add(const Cells *c, const long *cell, int lanes, const VolumeTerm *m, double *r) {
  for (int l = 0; l < lanes; ++l)
    for (int a = 0; a < PRESSURE_NODES; ++a) r[c->pressure_nodes[PRESSURE_NODES * cell[l] + a]] += m->r[a][l];
}

INLINE void volume_jacobian_point(const Cells *c, VolumeTerm *m, int q, Parameters p, const real *F, const real *I, real weight) {
  const double *N = c->pressure_basis + PRESSURE_NODES * q, *d = c->gradients + 3 * NODES * q;
  real conjugate[3], cofactor[9], S[9];
  conjugate_point(c, m, q, p, conjugate);
  determinant(F, cofactor);
  pull_back(cofactor);
  to_reference(cofactor, I, S);
  for (int b = 0; b < NODES; ++b)
    for (int i = 0; i < 3; ++i) {
      const real dJ = along(S, d + 3 * b, i) * weight;
      for (int a = 0; a < PRESSURE_NODES; ++a) m->B[b][i][a] += N[a] * dJ;
    }
  for (int a = 0; a < PRESSURE_NODES; ++a)
    for (int b = 0; b < PRESSURE_NODES; ++b) m->C[a][b] += N[a] * N[b] * conjugate[2] * weight;
}

INLINE void volume_jacobian_add(const Cells *c, const MatrixTarget *t, const long *cell, int lanes, int filter, const VolumeTerm *m,
                                real *K, int constrained, const real free[][3]) {
  for (int l = 0; l < lanes; ++l) {
    const int *position = positions(c, t, cell[l]);
    const int *nodes = c->nodes + NODES * cell[l];
    for (int a = 0; a < PRESSURE_NODES; ++a) {
      const int *row = position + ALL_NODES * (NODES + a);
      for (int b = 0; b < NODES; ++b) {
        const int to = row[b], mirror = position[ALL_NODES * b + NODES + a], other = mirror & 3;
        double *at = t->values[to & 3] + (to >> 2), *transposed = t->values[other] + (mirror >> 2);
        const long step = t->stride[other][nodes[b]];
        for (int i = 0; i < COMPONENTS; ++i) {
          const double value = m->B[b][i][a][l] * (constrained ? free[b][i][l] : 1.0);
          at[i] += value;
          transposed[step * i] += value;
        }
      }
      for (int b = 0; b < PRESSURE_NODES; ++b) {
        const int to = row[NODES + b];
        t->values[to & 3][to >> 2] -= m->C[a][b][l];
      }
    }
  }
}
