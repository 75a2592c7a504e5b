/* P2P1, Q2Q1, Taylor & Hood 1973: the pressure p is unknown and continuous. The energy density is
 * psi' + p J - U*(p), stationary in p where J = d(U*)/dp; the Jacobian is the saddle
 *   [ H   B^T ]   B = integral of N dJ/du,  C = integral of N N^T d2(U*)/dp2
 *   [ B   -C  ]   which is 0 at nu = 0.5.
 *
 * The code generator provides volume_dual(law, {U*, dU*, d2U*}). */

typedef struct {
  real p[PRESSURE_NODES][1], r[PRESSURE_NODES], B[PRESSURE_NODES][NODES][3], C[PRESSURE_NODES][PRESSURE_NODES];
} Volume;

INLINE void volume_begin(const Cells *c, long start, const real x[][3], const real v[][3], const double *pressure, Volume *m) {
  *m = (Volume){0};
  GATHER(m->p, PRESSURE_NODES, 1, c->pressure_nodes, pressure)
}

INLINE Law volume_law(const Cells *c, const Volume *m, int q) {
  Law p = {c->constants, splat(0)};
  for (int a = 0; a < PRESSURE_NODES; ++a) p.pressure += m->p[a][0] * c->pressure_basis[PRESSURE_NODES * q + a];
  return p;
}

INLINE real volume_density(Law p, const Volume *m, const real *F) {
  real dual[3];
  volume_dual(p, dual);
  return -dual[0];
}

INLINE void volume_residual_point(const Cells *c, Volume *m, int q, Law p, const real *F, real weight) {
  real dual[3], cofactor[9];
  volume_dual(p, dual);
  const real gap = (volume_point(F, cofactor) - dual[1]) * weight;
  for (int a = 0; a < PRESSURE_NODES; ++a) m->r[a] += c->pressure_basis[PRESSURE_NODES * q + a] * gap;
}

INLINE void volume_residual_end(const Cells *c, long start, int lanes, const Volume *m, double *r) {
  for (int l = 0; l < lanes; ++l)
    for (int a = 0; a < PRESSURE_NODES; ++a) r[c->pressure_nodes[PRESSURE_NODES * (start + l) + a]] += m->r[a][l];
}

INLINE void volume_jacobian_point(const Cells *c, Volume *m, int q, Law p, const real *F, const real *G, real weight) {
  const double *N = c->pressure_basis + PRESSURE_NODES * q;
  real dual[3], H[9];
  volume_dual(p, dual);
  volume_point(F, H);
  for (int b = 0; b < NODES; ++b)
    for (int i = 0; i < 3; ++i) {
      const real dJ = (H[i] * G[3 * b] + H[3 + i] * G[3 * b + 1] + H[6 + i] * G[3 * b + 2]) * weight;
      for (int a = 0; a < PRESSURE_NODES; ++a) m->B[a][b][i] += N[a] * dJ;
    }
  for (int a = 0; a < PRESSURE_NODES; ++a)
    for (int b = 0; b < PRESSURE_NODES; ++b) m->C[a][b] += N[a] * N[b] * dual[2] * weight;
}

INLINE void volume_jacobian_end(const Cells *c, const Target *t, long start, int lanes, int filter, const Volume *m,
                                real *K, int constrained, const real free[][3]) {
  for (int l = 0; l < lanes; ++l) {
    const int *position = t->position + (long)ALL_NODES * ALL_NODES * (start + l);
    const int *nodes = c->nodes + NODES * (start + l);
    for (int a = 0; a < PRESSURE_NODES; ++a) {
      const int *row = position + ALL_NODES * (NODES + a);
      for (int b = 0; b < NODES; ++b) {
        const int to = row[b], back = position[ALL_NODES * b + NODES + a], whose = back & 3;
        double *at = t->values[to & 3] + (to >> 2), *transposed = t->values[whose] + (back >> 2);
        const long step = t->stride[whose][nodes[b]];
        for (int i = 0; i < 3; ++i) {
          const double value = m->B[a][b][i][l] * (constrained ? free[b][i][l] : 1.0);
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
