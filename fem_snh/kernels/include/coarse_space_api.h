/* The deflation space on a SymmetricBlockMatrix: the columns of Z are displacements that are linear in the reference
 * coordinates in one subdomain of the nodes and zero in the others, COLUMNS per subdomain (BLOCK components times
 * 4 functions; in two dimensions the fourth is the product of the coordinates). The C compiler and cffi read this one file.
 *
 * A row of Z has entries in the columns of one subdomain; a block row of A Z has entries for the subdomains of
 * the node and of its neighbours: these pairs (row, subdomain) are stored. */
typedef struct {
  int rows;                   /* block rows of the matrix on this rank */
  const int *subdomain;       /* [rows + ghosts] subdomain of each node */
  const float *functions;     /* [rows + ghosts][BLOCK][4] Z by node, component and function */
  const int *aij_column;      /* block columns of the AIJ matrix's diagonal block */
  const int *pair_start;      /* [rows + 1] index of a row's first pair */
  const int *pair_subdomain;  /* [pairs] */
  const int *pair_block;      /* [pairs] the block of E to which the pair adds */
  float *image;               /* [pairs][BLOCK][COLUMNS] A Z */
} CoarseSpace;

/* Compute A Z from the values of the AIJ matrix, times `scale`, and add these rows' part of E = Z^T A Z to
 * its blocks E[blocks][COLUMNS][COLUMNS]. */
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

/* coupled[rows][BLOCK] = 1 where a row of the AIJ matrix has a nonzero entry beside its diagonal. The other
 * unknowns are prescribed, or have no stiffness. */
void matrix_coupled_unknowns(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, unsigned char *coupled);
