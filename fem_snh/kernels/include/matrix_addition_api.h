/* The C interface of the addition of stored matrices. MatrixTarget is in cell_api.h. */

/* Add element matrices to `t`, without the rows and columns of constrained components.
 *   count .... number of matrices
 *   cells .... [count] the cell of each matrix
 *   blocks ... blocks per element matrix: the first ones of the cell
 *   all_blocks blocks per cell in `cell_blocks` and `t->position`
 *   size ..... [blocks] unknowns of each block: 2 or 3 of displacement nodes, which come first, 1 of a pressure
 *   cell_blocks [cells][all_blocks] local block numbers, by which `t->stride` and `t->free` are indexed
 *   K ........ [count][n][n], n the sum of `size` */
void add_matrices(const MatrixTarget *t, int count, const int *cells, int blocks, int all_blocks, const int *size,
                  const int *cell_blocks, const double *K);

/* Add multiples of the identity to `t`, one for each pair of displacement nodes, without constrained components.
 *   components  displacement components of a node
 *   rows ..... number of local nodes
 *   start .... [rows + 1], column [pairs]: a CSR pattern of local nodes
 *   position . [pairs] the position of each pair, encoded as MatrixTarget.position
 *   factor ... common factor of value [pairs] */
void add_node_pairs(const MatrixTarget *t, int components, int rows, const int *start, const int *column, const int *position,
                    double factor, const double *value);
