int block_pattern(long n, const int *rows, const int *columns, long num_rows, long num_columns,
                  long *indptr, int *indices);
long block_indices(long n, const int *rows, const int *columns, const long *indptr,
                   const int *indices, long *found);
long cell_pattern(long num_cells, int n, const int *cells, long num_rows, long *indptr,
                  int *indices);
int cell_positions(long num_cells, int n, const int *cells, long num_rows, const long *indptr,
                   const int *indices, const int *positions, int *found);
/* Block columns of a matrix: a CSR pattern, and the first unknown and the size of each block column. */
typedef struct {
    const long *indptr;
    const int *indices, *unknown, *size;
} BlockColumns;
void unknown_columns(long num_rows, const int *row_size, const BlockColumns *own,
                     const BlockColumns *others, long before, int *columns);
