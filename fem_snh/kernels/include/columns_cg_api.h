/* SSOR-preconditioned conjugate gradients for LANES right-hand sides. The C compiler and cffi read this one file;
 * Python fills the struct by field name. Vectors are [rows][LANES] doubles, sums and norms [LANES]. */

/* One rank's rows of a symmetric matrix A = L + I + L^T with unit diagonal, in compressed rows whose columns ascend,
 * and the vectors of Saad 2003, alg. 9.1, for A-hat = (I + L)^-1 A (I + L)^-T: x, r, p,
 * t = (I + L)^-T p, whose multiples add up to x, and w = A-hat p - t. */
typedef struct {
  int rows;
  const int *start;         /* [rows + 1] index of a row's first entry */
  const int *diagonal;      /* [rows] index of its diagonal entry */
  const int *column;
  const double *value;
  const int *ghost_start;   /* the same of other ranks' columns, numbered from 0; NULL on one rank */
  const int *ghost_column;
  const double *ghost_value;
  const double *ghosts;     /* [ghosts][LANES] other ranks' t */
  double *x, *r, *p, *t, *w;
} ColumnsCG;

/* r = (I + L)^-1 r, x = p = 0; rho = r.r. */
void columns_start(const ColumnsCG *c, double *rho);

/* p = r + rho/previous p, t = (I + L)^-T p; previous = 0: p = r. */
void columns_backward(const ColumnsCG *c, const double *rho, const double *previous);

/* w = A-hat p - t; curvature = p.(t + w). */
void columns_forward(const ColumnsCG *c, double *curvature);

/* x += alpha t, r -= alpha (t + w) with alpha = rho/curvature, or 0 where the curvature is not positive; updated = r.r. */
void columns_update(const ColumnsCG *c, const double *rho, const double *curvature, double *updated);
