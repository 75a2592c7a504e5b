/* The C interface of the addition of stored element matrices. MatrixTarget is in cell_api.h. */

/* Add element matrices to `t`, without the rows and columns of constrained components.
 *   count .... number of matrices
 *   cells .... [count] the cell of each
 *   blocks ... blocks per element matrix, and all_blocks those of a cell in `cell_blocks` and `t->position`
 *   size ..... [blocks] unknowns of each block: 3 (displacement) or 1 (pressure)
 *   cell_blocks [cells][all_blocks] local numbers, by which `t->stride` and `t->free` are indexed
 *   K ........ [count][n][n], n the sum of `size` */
void add_matrices(const MatrixTarget *t, int count, const int *cells, int blocks, int all_blocks, const int *size,
                  const int *cell_blocks, const double *K);
