/* The addition of values to a MatrixTarget (cell_api.h), on split_double.h. Inlined in full, so that sizes are known at compilation. */
#define ADDITION static inline __attribute__((always_inline))

/* Add v to the value at an offset of an array. */
ADDITION void add_value(const MatrixTarget *t, int array, long offset, double v) {
  if (t->high[array]) {
    float *high = t->high[array] + offset;
    int *rest = t->rest[array] + offset;
    split(join(*high, *rest) + t->scale * v, high, rest);
  } else
    t->values[array][offset] += v;
}

/* Add size rows and columns (2 or 3) of K to the block of a row's `node` at a position; a row of K is `down` doubles after
 * the one before, a column `right`. The lane after the columns of a row belongs to the next value, to which 0 is added;
 * split arrays have 4 more at their end. */
ADDITION void add_block(const MatrixTarget *t, long node, int position, int size, const double *K, long down, long right) {
  if (position < 0) return;
  const int array = position & 3;
  const long stride = t->stride[array][node], offset = position >> 2;
  if (t->high[array]) {
    float *high = t->high[array] + offset;
    int *rest = t->rest[array] + offset;
    for (int i = 0; i < size; ++i, K += down, high += stride, rest += stride) {
      const double4 row = {K[0], K[right], size == 3 ? K[2 * right] : 0, 0};
      split4(join4(high, rest) + t->scale * row, high, rest);
    }
    return;
  }
  double *at = t->values[array] + offset;
  for (int i = 0; i < size; ++i, K += down, at += stride)
    for (int j = 0; j < size; ++j) at[j] += K[right * j];
}

/* Prefetch, to write to them, the values of a block of `size` rows. */
ADDITION void prefetch_block(const MatrixTarget *t, long node, int position, int size) {
  if (position < 0) return;
  const int array = position & 3;
  const long stride = t->stride[array][node], offset = position >> 2;
  for (int i = 0; i < size; ++i)
    if (t->high[array]) {
      __builtin_prefetch(t->high[array] + offset + stride * i, 1);
      __builtin_prefetch(t->rest[array] + offset + stride * i, 1);
    } else
      __builtin_prefetch(t->values[array] + offset + stride * i, 1);
}
