/* The C interface of the loops over FFCx's element kernels. The C compiler and cffi read this one file. */

/* The cells that this rank owns. */
typedef struct {
  int nodes;              /* displacement nodes per cell */
  int components;         /* displacement components of a node */
  int geometry_nodes;     /* geometry nodes per cell */
  const int *geometry;    /* [cells][geometry_nodes] */
  const double *x;        /* [.][3] reference coordinates of the geometry nodes [m] */
} FormCells;

/* One integral of a bilinear form. */
typedef struct {
  void *kernel;               /* FFCx's tabulate_tensor */
  int width;                  /* 1: over cells; 2: over exterior facets */
  const int *entities;        /* [entities][width] cell, and the facet's number within the cell */
  int num_coefficients;       /* values per entity */
  const double *coefficients; /* [entities][num_coefficients] */
  const double *constants;
} FormIntegral;

/* Tabulate the element matrices K[count][n][n], n = components * nodes, of the entities start, start + 1, ..., or their
 * symmetric parts. Returns the largest max |K - K^T| / max |K| of these entities. */
double tabulate_entities(const FormCells *c, const FormIntegral *f, int start, int count, int symmetric, double *K);

/* Write the indices of those of `count` symmetric n x n matrices that are not positive semidefinite, or not finite, to
 * `indefinite`; return how many there are. An eigenvalue above -shift times the largest entry counts as zero.
 * `work` has n * n entries. */
int find_indefinite(int n, int count, const double *K, double shift, double *work, int *indefinite);
