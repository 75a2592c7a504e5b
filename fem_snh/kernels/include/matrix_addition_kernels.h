/* The addition of stored matrices: see matrix_addition_api.h. */

void add_matrices(const MatrixTarget *t, int count, const int *cells, int blocks, int all_blocks, const int *size,
                  const int *cell_blocks, const double *K) {
  int n = 0;
  for (int a = 0; a < blocks; ++a) n += size[a];
  for (long k = 0; k < count; ++k, K += (long)n * n) {
    const long cell = cells[k];
    const int *block = cell_blocks + all_blocks * cell;
    const int *position = t->position + (long)all_blocks * all_blocks * cell;
    for (int a = 0, row = 0; a < blocks; row += size[a++])
      for (int b = 0, column = 0; b < blocks; column += size[b++]) {
        const int to = position[all_blocks * a + b], array = to & 3;
        if (to < 0) continue;
        const long stride = t->stride[array][block[a]];
        for (int i = 0; i < size[a]; ++i) {
          if (size[a] == size[0] && t->free[size[0] * (long)block[a] + i] == 0) continue;
          for (int j = 0; j < size[b]; ++j)
            if (size[b] != size[0] || t->free[size[0] * (long)block[b] + j] != 0)
              add_value(t, array, (to >> 2) + stride * i + j, K[(long)n * (row + i) + column + j]);
        }
      }
  }
}

void add_node_pairs(const MatrixTarget *t, int components, int rows, const int *start, const int *column, const int *position,
                    double factor, const double *value) {
  for (long row = 0; row < rows; ++row) {
    const double *free_row = t->free + components * row;
    for (int k = start[row]; k < start[row + 1]; ++k) {
      const double *free_column = t->free + components * (long)column[k];
      const int array = position[k] & 3;
      if (position[k] < 0) continue;
      const long stride = t->stride[array][row];
      for (int i = 0; i < components; ++i)
        if (free_row[i] != 0 && free_column[i] != 0) add_value(t, array, (position[k] >> 2) + (stride + 1) * i, factor * value[k]);
    }
  }
}
