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
  const int *pair_start;      /* [rows + 1] index of a row's first pair */
  const int *pair_subdomain;  /* [pairs] subdomain of each pair */
  const int *pair_block;      /* [pairs] the block of E to which the pair adds */
  float *image;               /* [pairs][BLOCK][COLUMNS] A Z */
} CoarseSpace;

/* Set the pairs of each row from the pattern in this rank's columns, that of `b` in others, and the subdomain of each node:
 * pair_start[rows + 1] and, unless it is NULL, the ascending pair_subdomain. list[subdomains] is work space. Returns the
 * number of pairs. */
int coarse_pairs(const SymmetricBlockMatrix *b, const int *start, const int *column, const int *subdomain, int *list, int *pair_start, int *pair_subdomain);

/* Compute A Z, where A is `scale` times the AIJ matrix, and add the contribution of this rank's rows to the
 * blocks E[blocks][COLUMNS][COLUMNS] of E = Z^T A Z. */
void coarse_assemble(const SymmetricBlockMatrix *b, const CoarseSpace *c, const double *values, const double *off_diagonal,
                     double scale, double *E);

/* The same without an AIJ matrix. Each block of U is read once, with its transpose: the sums of a row are complete after the
 * `bandwidth` rows that follow, and wait in sums[window][ENTRIES][4], which is zero before and after. `coarse_window` sets the
 * largest distance of two coupled rows, and returns the pairs of that many rows on either side, as a power of two. */
int coarse_window(const SymmetricBlockMatrix *b, const CoarseSpace *c, int *bandwidth);
void coarse_assemble_half(const SymmetricBlockMatrix *b, const CoarseSpace *c, int bandwidth, int window, double *sums, double *E);

/* y += (A Z)^T t. */
void coarse_image_transposed(const CoarseSpace *c, const float *t, double *y);

/* r -= A Z y. */
void coarse_image_subtract(const CoarseSpace *c, const float *y, float *r);

/* y += Z^T r. */
void coarse_restrict(const CoarseSpace *c, const float *r, double *y);

/* x += Z y. */
void coarse_prolong(const CoarseSpace *c, const float *y, float *x);

/* coupled[rows][BLOCK] = 1 where a row of the matrix has a nonzero entry off its diagonal, otherwise 0: the
 * unknown is then prescribed, or has no stiffness. */
void matrix_coupled_unknowns(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, unsigned char *coupled);
