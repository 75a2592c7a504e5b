int block_pattern(long n, const int *rows, const int *columns, long num_rows, long num_columns,
                  long *indptr, int *indices);
long block_indices(long n, const int *rows, const int *columns, const long *indptr,
                   const int *indices, long *found);
