/* The block matrix of SSOR-preconditioned conjugate gradients. The C compiler and cffi read this one file;
 * Python fills the struct by field name. A block has BLOCK rows, 2 or 3, the components of a displacement, and
 * ENTRIES = BLOCK^2 entries. Vectors are [rows][BLOCK] floats unless stated. */

/* The stages of a forward substitution, and in the opposite order of a backward one. Rows that couple to other ranks
 * are late if one of these is lower, else early: early rows couple to other ranks' late rows only, and precede them. One
 * rank alone has interior rows only. */
enum { EARLY, INTERIOR, LATE };

/* One rank's rows of a symmetric matrix of blocks in single precision, A = L + D - shift + L^T + R. D is block
 * diagonal. L has the couplings of rows to earlier rows in the order of the sweeps, those of a late row to other ranks'
 * early rows among them; R has the couplings of late rows to other ranks' late rows. Of the couplings between this
 * rank's rows only U = L^T is stored, its rows in the order of the sweeps. A block row of U with n blocks is BLOCK rows
 * of BLOCK n floats. The columns of other ranks are stored alike, as in PETSc's AIJ format.
 *
 * The values are copies of an AIJ matrix's. Or element matrices are added to them directly (cell_api.h): then there is no
 * AIJ matrix, "_rest" arrays hold what the floats lack (split_double.h), and the addresses of its values are NULL in all functions.
 * Its arrays aij_start, aij_column, aij_diagonal and half_offset are then there in `matrix_order`, and the first two in
 * `matrix_to_aij`.
 * Arrays with "4 more" floats have them at the end, because the load of a last block reads beyond it. */
typedef struct {
  int rows;                     /* block rows */
  double largest;               /* the largest diagonal entry of the scaled A on all ranks; 1 of zeros */
  int *order;                   /* [rows] the rows in the order of the forward sweep: early, interior, late */
  int *stage_start;             /* [4] index in `order` of each stage's first row, and `rows` */
  int *upper_start;             /* [rows + 1] index of the first block in U of each row in `order` */
  int *upper_column;            /* block columns of U */
  int *upper_value;             /* offset of each block's first value in the AIJ matrix's diagonal block */
  const int *aij_start;         /* [rows + 1] index of a row's first block in the AIJ matrix's diagonal block */
  const int *aij_column;        /* block column of each of these blocks, ascending in each row */
  int *aij_diagonal;            /* [rows] position of the diagonal block in a row of the AIJ matrix */
  const long *aij_offset;       /* [rows] offset of a block row's first value in the AIJ matrix */
  const int *aij_stride;        /* [rows] values in each scalar row of a block row: its blocks' values, then others */
  float *upper;                 /* U, and 4 more */
  float *diagonal;              /* [rows][ENTRIES] and 4 more: D, A's diagonal blocks plus `shift` */
  float *diagonal_inverse;      /* [rows][ENTRIES] and 4 more: D^-1 */
  float *link;                  /* [rows + 1][2][2] if BLOCK is 2: L_ij D_j^-1 of rows j, i that are consecutive in `order`, by columns; 0 where L_ij = 0 */
  float *lanes;                 /* [rows][2][4] work space of the sweeps */
  const int *off_diagonal_start;  /* [rows + 1] index of a row's first block in other ranks' columns; NULL on one rank */
  const int *off_diagonal_column; /* ghost node of each block */
  const long *off_diagonal_value;   /* offset of each block's first value in the AIJ matrix's off-diagonal block */
  const int *off_diagonal_stride;   /* [rows] values in each scalar row of the AIJ matrix's off-diagonal block */
  float *off_diagonal;            /* the blocks of other ranks' columns, stored as U */
  const float *ghost_stage;       /* [ghosts] EARLY or LATE */
  const float *ghosts;            /* [ghosts][BLOCK] values at the ghost nodes, as each function says */
  const float *other_ghosts;      /* [ghosts][BLOCK] likewise, of a second vector */
  float *shift;                   /* [rows][BLOCK] REMAINDER_WEIGHT times the absolute row sums of R */
  float *own_diagonal;            /* [rows][ENTRIES] and 4 more: A's diagonal blocks; NULL for copies of an AIJ matrix, as the following ones */
  int *own_diagonal_rest, *upper_rest, *off_diagonal_rest; /* the rest of A's values; 4 more each, and after off_diagonal */
  int *place;                     /* [rows] index of each row in `order` */
  int *half_offset;               /* offset of each block of `aij_column` in own_diagonal or U; -1 for a block below the diagonal */
} SymmetricBlockMatrix;

/* Write the stage of each row to stage[rows][BLOCK]. `start` and `column` are the pattern in other ranks' columns;
 * higher ranks own the ghosts from number `higher` on. */
void matrix_stages(int rows, const int *start, const int *column, int higher, float *stage);

/* Set `order`, `stage_start`, `aij_diagonal` and the pattern of U from the stages of the rows and from the values'
 * offsets of the AIJ matrix's blocks, or `half_offset` and `place` without it. Returns 0, or 1 if the pattern is not
 * symmetric with a full diagonal. */
int matrix_order(const SymmetricBlockMatrix *b, const float *stage, const int *offsets);

/* Copy the values of an AIJ matrix's diagonal and off-diagonal block, times `scale`, add `shift` to D and invert D.
 * translations[BLOCK] = this rank's part of x.A x of the unit translations x, in double precision. Returns the number
 * of block rows whose diagonal block is not positive definite. */
long matrix_fill(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, double scale,
                 double *translations);

/* The largest |entry| on the diagonal of the matrix; infinity if one is not finite. */
double matrix_largest_diagonal(const SymmetricBlockMatrix *b, const double *values);

/* The functions with a `stage` do that part of their work. Forward ones have to be called for EARLY, INTERIOR and LATE;
 * between the first and the last, `ghosts` must receive the result of EARLY from other ranks' early rows. */

/* w = (D + L)^-1 w. Returns 0. */
double matrix_solve_lower(const SymmetricBlockMatrix *b, int stage, float *w);

/* w = (D + L)^-1 w and y = (D + L)^-1 y in one sweep; other_ghosts receive y. LATE returns y.D y = r.M^-1 r of the
 * former y = r, where M is the preconditioner (D + L) D^-1 (D + L)^T. */
double matrix_solve_lower_both(const SymmetricBlockMatrix *b, int stage, float *w, float *y);

/* y = factor (D + L) w, in double precision; the ghosts receive w. Returns 0. */
double matrix_multiply_lower(const SymmetricBlockMatrix *b, int stage, const float *w, double factor, double *y);

/* p = z + beta p, t = (D + L)^-T p, w = L^T t. The stages are LATE, INTERIOR and EARLY; the ghosts must receive t of
 * LATE before EARLY. Returns 0. */
double matrix_backward_sweep(const SymmetricBlockMatrix *b, int stage, float beta, const float *z, float *p, float *t, float *w);

/* q = t + (D + L)^-1 (w - shift t + R t), with t at the late ghosts. EARLY leaves the solution's early rows in q for
 * the early ghosts to receive. LATE returns p.q. */
double matrix_forward_sweep(const SymmetricBlockMatrix *b, int stage, const float *p, const float *t, const float *w, float *q);

/* p.D^-1 p. */
double matrix_weighted_norm(const SymmetricBlockMatrix *b, const float *p);

/* x += alpha t, r -= alpha q, z = D r. Returns r.z. */
double matrix_cg_update(const SymmetricBlockMatrix *b, float alpha, const float *t, const float *q, float *x, float *r, float *z);

/* The functions below are for a matrix without AIJ values. */

/* The pattern of the whole diagonal block: start[rows + 1] and, unless it is NULL, the ascending columns of each row. */
void matrix_pattern(const SymmetricBlockMatrix *b, int *start, int *column);

/* Multiply all values by `factor`, a power of two. */
void matrix_scale(const SymmetricBlockMatrix *b, double factor);

/* y = A x in double precision, or |A| x of the absolute values; x_ghosts[ghosts][BLOCK] are values of x at the ghost nodes. */
void matrix_multiply(const SymmetricBlockMatrix *b, int absolute, const double *x, const double *x_ghosts, double *y);

/* Write the values, divided by `scale`, to an AIJ matrix of the same pattern that has no other columns. */
void matrix_to_aij(const SymmetricBlockMatrix *b, double scale, double *values, double *off_diagonal);
