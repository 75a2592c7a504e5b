/* Q1, Q2, P1, P2: the volume term is part of the material's energy at every point; nothing to add. */

typedef struct {
  char unused;
} VolumeTerm;

INLINE void volume_prepare(const Cells *c, real fraction, const long *cell, const real x[][3], const real v[][3], const double *pressure, VolumeTerm *m) {
  m->unused = 0;
}

INLINE Parameters volume_parameters(const Cells *c, const VolumeTerm *m, int q) { return (Parameters){c->constants, splat(0)}; }

INLINE real volume_energy_density(const Cells *c, int q, Parameters p, const VolumeTerm *m, const real *F) { return splat(0); }

INLINE void volume_residual_point(const Cells *c, VolumeTerm *m, int q, Parameters p, const real *F, const real *H, real weight) {}

INLINE void volume_residual_add(const Cells *c, const long *cell, int lanes, const VolumeTerm *m, double *r) {}

INLINE void volume_jacobian_point(const Cells *c, VolumeTerm *m, int q, Parameters p, const real *F, const real *I, real weight) {}

INLINE void volume_jacobian_add(const Cells *c, const MatrixTarget *t, const long *cell, int lanes, int filter, const VolumeTerm *m,
                                real *K, int constrained, const real free[][3]) {}
