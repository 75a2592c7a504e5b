/* The deflation space of a SymmetricBlockMatrix: the columns of Z are displacements that are linear in the reference
 * coordinates in one subdomain of the nodes and zero in all others, COLUMNS per subdomain (BLOCK components times
 * 4 functions; in two dimensions the fourth is the product of the coordinates). The C compiler and cffi read this one file.
 *
 * A row of Z has entries in the columns of one subdomain. A block row of A Z has entries for the subdomains of
 * the row's node and of its neighbours; a pair is such a (block row, subdomain). */
typedef struct {
  int rows;                   /* block rows of the matrix on this rank */
  const int *subdomain;       /* [rows + ghosts] subdomain of each node */
  const float *functions;     /* [rows + ghosts][BLOCK][4] Z by node, component and function */
  const int *aij_column;      /* block column of each block in the AIJ matrix's diagonal block */
  const int *pair_start;      /* [rows + 1] index of a row's first pair */
  const int *pair_subdomain;  /* [pairs] subdomain of each pair */
  const int *pair_block;      /* [pairs] the block of E to which the pair adds */
  float *image;               /* [pairs][BLOCK][COLUMNS] A Z */
} CoarseSpace;

/* Compute A Z, where A is `scale` times the AIJ matrix, and add the contribution of this rank's rows to the
 * blocks E[blocks][COLUMNS][COLUMNS] of E = Z^T A Z. */
void coarse_assemble(const SymmetricBlockMatrix *b, const CoarseSpace *c, const double *values, const double *off_diagonal,
                     double scale, double *E);

/* y += (A Z)^T t. */
void coarse_image_transposed(const CoarseSpace *c, const float *t, double *y);

/* r -= A Z y. */
void coarse_image_subtract(const CoarseSpace *c, const float *y, float *r);

/* y += Z^T r. */
void coarse_restrict(const CoarseSpace *c, const float *r, double *y);

/* x += Z y. */
void coarse_prolong(const CoarseSpace *c, const float *y, float *x);

/* coupled[rows][BLOCK] = 1 where a row of the AIJ matrix has a nonzero entry off its diagonal, otherwise 0: the
 * unknown is then prescribed, or has no stiffness. */
void matrix_coupled_unknowns(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, unsigned char *coupled);
