/* Q1, Q2, P1, P2: the volume term is the material's, at every point, and nothing is done here. */

typedef struct {
  char nothing;
} Volume;

INLINE void volume_begin(const Cells *c, long start, const real x[][3], const real v[][3], const double *pressure, Volume *m) {
  m->nothing = 0;
}

INLINE Law volume_law(const Cells *c, const Volume *m, int q) { return (Law){c->constants, splat(0)}; }

INLINE real volume_density(Law p, const Volume *m, const real *F) { return splat(0); }

INLINE void volume_residual_point(const Cells *c, Volume *m, int q, Law p, const real *F, real weight) {}

INLINE void volume_residual_end(const Cells *c, long start, int lanes, const Volume *m, double *r) {}

INLINE void volume_jacobian_point(const Cells *c, Volume *m, int q, Law p, const real *F, const real *G, real weight) {}

INLINE void volume_jacobian_end(const Cells *c, const Target *t, long start, int lanes, int filter, const Volume *m,
                                real *K, int constrained, const real free[][3]) {}
