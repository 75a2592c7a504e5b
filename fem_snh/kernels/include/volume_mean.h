/* Q1P0, P2P0, mean dilatation (Nagtegaal, Parks & Rice 1974; Simo, Taylor & Pister 1985): the volume
 * term of a cell is V U(J_e), J_e = v/V the mean of J. Its derivatives are p dv and
 * p d2v + U''/V dv dv^T with p = U'(J_e): the first two are those of p J at every point, which the
 * material's own carry, filtered; the last is of rank one, and positive where U is convex.
 *
 * The code generator provides volume_curve(law, J, J - 1, {U, U', U''}): near rest J - 1 says more. */

typedef struct {
  real volume, U[3], pressure, dv[NODES][3]; /* dv: of the deformed volume, by the displacement */
} Volume;

INLINE void volume_begin(const Cells *c, long start, const real x[][3], const real v[][3], const double *pressure, Volume *m) {
  real G[3 * NODES], weight, F[9], H[9], cofactor[9], deformed = splat(0), change = splat(0);
  m->volume = splat(0);
  for (int q = 0; q < POINTS; ++q) {
    geometry_point(c, x, q, G, &weight);
    deformation_point(G, v, F, H);
    m->volume += weight;
    const real J = volume_point(F, cofactor);
    deformed += weight * J;
    change += weight * select(near_rest(H), volume_change(H, cofactor), J - 1);
  }
  volume_curve((Law){c->constants, splat(0)}, deformed / m->volume, change / m->volume, m->U);
  m->pressure = m->U[1];
  for (int a = 0; a < NODES; ++a)
    for (int i = 0; i < 3; ++i) m->dv[a][i] = splat(0);
}

INLINE Law volume_law(const Cells *c, const Volume *m, int q) { return (Law){c->constants, m->pressure}; }

INLINE real volume_density(Law p, const Volume *m, const real *F) {
  real cofactor[9];
  return m->U[0] - p.pressure * volume_point(F, cofactor);
}

INLINE void volume_residual_point(const Cells *c, Volume *m, int q, Law p, const real *F, real weight) {}

INLINE void volume_residual_end(const Cells *c, long start, int lanes, const Volume *m, double *r) {}

INLINE void volume_jacobian_point(const Cells *c, Volume *m, int q, Law p, const real *F, const real *G, real weight) {
  real H[9];
  volume_point(F, H);
  for (int a = 0; a < NODES; ++a)
    for (int i = 0; i < 3; ++i)
      m->dv[a][i] += (H[i] * G[3 * a] + H[3 + i] * G[3 * a + 1] + H[6 + i] * G[3 * a + 2]) * weight;
}

INLINE void volume_jacobian_end(const Cells *c, const Target *t, long start, int lanes, int filter, const Volume *m,
                                real *K, int constrained, const real free[][3]) {
  const real factor = filtered(filter, m->U[2]) / m->volume;
  for (int b = 0; b < NODES; ++b)
    for (int a = 0; a <= b; ++a, K += 9)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) K[3 * i + j] += factor * m->dv[a][i] * m->dv[b][j];
}
