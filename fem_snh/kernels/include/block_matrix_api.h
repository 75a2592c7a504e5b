/* The block matrix of SSOR-preconditioned conjugate gradients. The C compiler and cffi read this one file;
 * Python fills the struct by field name. A block has BLOCK rows, 2 or 3, the components of a displacement, and
 * ENTRIES = BLOCK^2 entries. Vectors are [rows][BLOCK] floats unless stated. */

/* One rank's rows of a symmetric matrix of blocks in single precision. The columns of this rank are
 * A = L + D - shift + L^T; the columns of other ranks are the off-diagonal block of PETSc's AIJ format. D is block
 * diagonal; of L and L^T only U = L^T is stored. A block row of U with n blocks is BLOCK rows of BLOCK n floats.
 * Arrays with "4 more" floats have them at the end, because the load of a last block reads beyond it. */
typedef struct {
  int rows;                     /* block rows */
  const int *upper_start;       /* [rows + 1] index of a row's first block in U */
  const int *upper_column;      /* block columns of U */
  const int *aij_start;         /* [rows + 1] index of a row's first block in the AIJ matrix's diagonal block */
  const int *aij_diagonal;      /* [rows] position of the diagonal block in a row of the AIJ matrix */
  const long *aij_offset;       /* [rows] offset of a block row's first value in the AIJ matrix */
  const int *aij_stride;        /* [rows] values in each scalar row of a block row: its blocks' values, then others */
  float *upper;                 /* U, and 4 more */
  float *diagonal;              /* [rows][ENTRIES] and 4 more: D, A's diagonal blocks plus `shift` */
  float *diagonal_inverse;      /* [rows][ENTRIES] and 4 more: D^-1 */
  float *link;                  /* [rows + 1][2][2] if BLOCK is 2: L_ij D_j^-1 with j = i - 1, by columns; 0 where L_ij = 0 */
  float *lanes;                 /* [rows][2][4] work space of the sweeps */
  const int *off_diagonal_start;  /* [rows + 1] index of a row's first block in other ranks' columns; NULL on one rank */
  const int *off_diagonal_column; /* ghost node of each block */
  const long *off_diagonal_value;   /* offset of each block's first value in the AIJ matrix's off-diagonal block */
  const int *off_diagonal_stride;   /* [rows] values in each scalar row of the AIJ matrix's off-diagonal block */
  float *off_diagonal;            /* the blocks of other ranks' columns, stored as U */
  float *shift;                   /* [rows][BLOCK] OFF_DIAGONAL_WEIGHT times the absolute row sums of `off_diagonal` */
} SymmetricBlockMatrix;

/* Copy the values of an AIJ matrix's diagonal and off-diagonal block, times `scale`, add `shift` to D and invert D.
 * Returns the number of block rows whose diagonal block is not positive definite. */
long matrix_fill(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, double scale);

/* The largest |entry| on the diagonal of the AIJ matrix; infinity if one is not finite. */
double matrix_largest_diagonal(const SymmetricBlockMatrix *b, const double *values);

/* w = (D + L)^-1 w. */
void matrix_solve_lower(const SymmetricBlockMatrix *b, float *w);

/* w = (D + L)^-1 w and y = (D + L)^-1 other in one sweep. Returns y.D y = other.M^-1 other, where M is the
 * preconditioner (D + L) D^-1 (D + U). */
double matrix_solve_lower_both(const SymmetricBlockMatrix *b, float *w, const float *other);

/* y = factor (D + L) w, in double precision. */
void matrix_multiply_lower(const SymmetricBlockMatrix *b, const float *w, double factor, double *y);

/* p = z + beta p, t = (D + U)^-1 p, w = U t. */
void matrix_backward_sweep(const SymmetricBlockMatrix *b, float beta, const float *z, float *p, float *t, float *w);

/* q = t + (D + L)^-1 (w - shift t + off_diagonal ghosts), with t at the ghost nodes in `ghosts`. Returns p.q. */
double matrix_forward_sweep(const SymmetricBlockMatrix *b, const float *p, const float *t, const float *ghosts, const float *w, float *q);

/* x += alpha t, r -= alpha q, z = D r. Returns r.z. */
double matrix_cg_update(const SymmetricBlockMatrix *b, float alpha, const float *t, const float *q, float *x, float *r, float *z);
