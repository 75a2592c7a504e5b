/* The block matrix of SSOR-preconditioned conjugate gradients. The C compiler and cffi read this one file;
 * Python fills the struct by field name. A block has BLOCK rows, 2 or 3, the components of a displacement, and
 * ENTRIES = BLOCK^2 entries. Vectors are [rows][BLOCK] floats unless stated. */

/* One rank's rows of a symmetric matrix of blocks in single precision. Its columns are those of this
 * rank, A = L + D - shift + L^T, and those of other ranks (the off-diagonal block of PETSc's AIJ format). D is block
 * diagonal; of L + L^T only U = L^T is stored. A block row of U with n blocks is BLOCK rows of BLOCK n floats. */
typedef struct {
  int rows;                     /* block rows */
  const int *upper_start;       /* [rows + 1] index of a row's first block in U */
  const int *upper_column;      /* block columns of U */
  const int *aij_start;         /* [rows + 1] index of a row's first block in the AIJ matrix */
  const int *aij_diagonal;      /* [rows] position of the diagonal block in a row of the AIJ matrix */
  const long *aij_offset;       /* [rows] offset of a block row's first value in the AIJ matrix */
  const int *aij_stride;        /* [rows] values in each of its rows: its blocks', then others */
  float *upper;                 /* U, and four floats more, as loads of a last block read beyond it */
  float *diagonal;              /* [rows][ENTRIES] and four more: D, of the preconditioner: A's plus `shift` */
  float *diagonal_inverse;      /* [rows][ENTRIES] and four more: D^-1 */
  float *link;                  /* [rows + 1][2][2] the products L_ij D_j^-1 with the last row, j = i - 1, by columns; or 0 */
  float *lanes;                 /* [rows][2][4] work space of the sweeps */
  const int *off_diagonal_start;  /* [rows + 1] the same of the other ranks' columns; NULL on one rank */
  const int *off_diagonal_column; /* ghost nodes */
  const long *off_diagonal_value;   /* offset of each block's first value in the AIJ matrix */
  const int *off_diagonal_stride;   /* [rows] values in each row of unknowns of the AIJ matrix */
  float *off_diagonal;            /* rows of blocks as in U */
  float *shift;                   /* [rows][BLOCK] part of their absolute row sums */
} SymmetricBlockMatrix;

/* Copy the values of an AIJ matrix, times `scale`, shift D and invert it. Returns the number of block rows whose
 * diagonal block is not positive definite. */
long matrix_fill(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, double scale);

/* The largest |entry| on the diagonal of the AIJ matrix; infinity if one is not finite. */
double matrix_largest_diagonal(const SymmetricBlockMatrix *b, const double *values);

/* w = (D + L)^-1 w. */
void matrix_solve_lower(const SymmetricBlockMatrix *b, float *w);

/* The same, in one sweep with y = (D + L)^-1 other. Returns y.D y, the square of other's natural norm. */
double matrix_solve_lower_both(const SymmetricBlockMatrix *b, float *w, const float *other);

/* y = factor (D + L) w, in double precision. */
void matrix_multiply_lower(const SymmetricBlockMatrix *b, const float *w, double factor, double *y);

/* p = z + beta p, t = (D + U)^-1 p, w = U t. */
void matrix_backward_sweep(const SymmetricBlockMatrix *b, float beta, const float *z, float *p, float *t, float *w);

/* q = t + (D + L)^-1 (w - shift t + the other ranks' columns times their t, in `ghosts`). Returns p.q. */
double matrix_forward_sweep(const SymmetricBlockMatrix *b, const float *p, const float *t, const float *ghosts, const float *w, float *q);

/* x += alpha t, r -= alpha q, z = D r. Returns r.z. */
double matrix_cg_update(const SymmetricBlockMatrix *b, float alpha, const float *t, const float *q, float *x, float *r, float *z);
