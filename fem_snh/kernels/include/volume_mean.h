/* Q1P0, P2P0: mean dilatation (Nagtegaal, Parks & Rice 1974; Simo, Taylor & Pister 1985).
 *
 * The volume term of a cell of volume V is V U(J_e), where J_e = v/V is the mean of J and v the deformed
 * volume. With p = U'(J_e) its first derivative is p dv and its second p d2v + (U''/V) dv dv^T. The terms in p
 * are the integrated derivatives of p J at the points: the material's energy contains p J, and its Hessian is
 * filtered. The last term has rank one and is positive semidefinite where U is convex.
 *
 * The code generator provides volume_energy(p, J, J - 1, {U, U', U''}); J - 1 is passed separately because
 * it is more accurate than J at small strain. */

typedef struct {
  real volume;        /* V */
  real U[3];          /* U, U', U'' at J_e */
  real pressure;      /* p = U'(J_e) */
  real dv[NODES][3];  /* derivative of the deformed volume by the nodal displacements */
} VolumeTerm;

INLINE void volume_prepare(const Cells *c, real fraction, const long *cell, const real x[][3], const real v[][3], const double *pressure, VolumeTerm *m) {
  real I[9], weight, F[9], H[9], cofactor[9], deformed = splat(0), change = splat(0);
  m->volume = splat(0);
  for (int q = 0; q < POINTS; ++q) {
    geometry_point(c, x, fraction, q, I, &weight);
    deformation_point(c, q, I, v, F, H);
    m->volume += weight;
    const real J = determinant(F, cofactor);
    deformed += weight * J;
    change += weight * select(small_strain(H), volume_increment(H, cofactor), J - 1);
  }
  volume_energy((Parameters){c->constants, splat(0)}, deformed / m->volume, change / m->volume, m->U);
  m->pressure = m->U[1];
  for (int a = 0; a < NODES; ++a)
    for (int i = 0; i < 3; ++i) m->dv[a][i] = splat(0);
}

INLINE Parameters volume_parameters(const Cells *c, const VolumeTerm *m, int q) { return (Parameters){c->constants, m->pressure}; }

INLINE real volume_energy_density(const Cells *c, int q, Parameters p, const VolumeTerm *m, const real *F) {
  real cofactor[9];
  return m->U[0] - p.pressure * determinant(F, cofactor);
}

INLINE void volume_residual_point(const Cells *c, VolumeTerm *m, int q, Parameters p, const real *F, const real *H, real weight) {}

INLINE void volume_residual_add(const Cells *c, const long *cell, int lanes, const VolumeTerm *m, double *r) {}

INLINE void volume_jacobian_point(const Cells *c, VolumeTerm *m, int q, Parameters p, const real *F, const real *I, real weight) {
  const double *d = c->gradients + 3 * NODES * q;
  real cofactor[9], S[9];
  determinant(F, cofactor);
  pull_back(cofactor);
  to_reference(cofactor, I, S);
  for (int a = 0; a < NODES; ++a)
    for (int i = 0; i < 3; ++i)
      m->dv[a][i] += along(S, d + 3 * a, i) * weight;
}

INLINE void volume_jacobian_add(const Cells *c, const MatrixTarget *t, const long *cell, int lanes, int filter, const VolumeTerm *m,
                                real *K, int constrained, const real free[][3]) {
  const real factor = filter_eigenvalue(filter, m->U[2]) / m->volume;
  for (int b = 0; b < NODES; ++b)
    for (int a = 0; a <= b; ++a, K += 9)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) K[3 * i + j] += factor * m->dv[a][i] * m->dv[b][j];
}
