/* The functions of coarse_space_api.h. COLUMNS is BLOCK components times the four lanes of f4. */
typedef double d4 __attribute__((vector_size(32), aligned(8)));

/* sum[BLOCK][BLOCK] += block * g: a block whose rows are `step` doubles apart, times a node's functions, times `scale`. */
static inline __attribute__((always_inline)) void add_block(d4 *sum, const double *block, long step, double scale, const float *functions) {
  d4 g[BLOCK];
  for (int k = 0; k < BLOCK; k++) g[k] = scale * __builtin_convertvector(load4(functions + 4 * k), d4);
  for (int r = 0; r < BLOCK; r++)
    for (int k = 0; k < BLOCK; k++) sum[BLOCK * r + k] += block[step * r + k] * g[k];
}

/* The position of the pair (row, subdomain) among the pairs of the row. */
static inline int find_pair(const CoarseSpace *c, int row, int subdomain) {
  int at = c->pair_start[row];
  while (c->pair_subdomain[at] != subdomain) at++;
  return at - c->pair_start[row];
}

void coarse_assemble(const SymmetricBlockMatrix *b, const CoarseSpace *c, const double *values, const double *off_diagonal,
                     double scale, double *E) {
  for (int i = 0; i < c->rows; i++) {
    const int pairs = c->pair_start[i + 1] - c->pair_start[i], all = b->aij_start[i + 1] - b->aij_start[i];
    d4 acc[ENTRIES * pairs];
    memset(acc, 0, sizeof acc);
    const double *row = values + b->aij_offset[i];
    d4 sum[ENTRIES];  /* of blocks whose columns are in one subdomain: in registers */
    int pair = -1;
    for (int k = 0; k < all; k++) {
      const int j = c->aij_column[b->aij_start[i] + k], s = find_pair(c, i, c->subdomain[j]);
      prefetch_after(row + ENTRIES * k);
      if (s != pair) {
        for (int m = 0; m < ENTRIES && pair >= 0; m++) acc[ENTRIES * pair + m] = sum[m];
        for (int m = 0; m < ENTRIES; m++) sum[m] = acc[ENTRIES * s + m];
        pair = s;
      }
      add_block(sum, row + BLOCK * k, b->aij_stride[i], scale, c->functions + COLUMNS * (long)j);
    }
    for (int m = 0; m < ENTRIES && pair >= 0; m++) acc[ENTRIES * pair + m] = sum[m];
    if (b->off_diagonal_start) {
      const int from = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - from;
      for (int k = 0; k < n; k++) {
        const int j = c->rows + b->off_diagonal_column[from + k];
        add_block(acc + ENTRIES * find_pair(c, i, c->subdomain[j]), off_diagonal + b->off_diagonal_value[from + k],
                  b->off_diagonal_stride[i], scale, c->functions + COLUMNS * (long)j);
      }
    }
    const float *g = c->functions + COLUMNS * (long)i;
    for (int s = 0; s < pairs; s++) {
      const d4 *at = acc + ENTRIES * s;
      float *image = c->image + (long)BLOCK * COLUMNS * (c->pair_start[i] + s);
      for (int m = 0; m < ENTRIES; m++) *(f4 *)(image + 4 * m) = __builtin_convertvector(at[m], f4);
      double *to = E + COLUMNS * COLUMNS * (long)c->pair_block[c->pair_start[i] + s];
      for (int a = 0; a < COLUMNS; a++)
        for (int m = 0; m < BLOCK; m++)
          *(d4 *)(to + COLUMNS * a + 4 * m) += (double)g[a] * at[BLOCK * (a / 4) + m];
    }
  }
}

/* While consecutive rows belong to one subdomain, its sums stay in registers. */
void coarse_image_transposed(const CoarseSpace *c, const float *t, double *y) {
  if (!c->rows) return;
  double *at = y + COLUMNS * (long)c->pair_subdomain[0];
  d4 sum[BLOCK];
  for (int m = 0; m < BLOCK; m++) sum[m] = *(d4 *)(at + 4 * m);
  for (int i = 0; i < c->rows; i++, t += BLOCK)
    for (int s = c->pair_start[i]; s < c->pair_start[i + 1]; s++) {
      const float *w = c->image + (long)BLOCK * COLUMNS * s;
      double *to = y + COLUMNS * (long)c->pair_subdomain[s];
      if (to != at) {
        for (int m = 0; m < BLOCK; m++) {
          *(d4 *)(at + 4 * m) = sum[m];
          sum[m] = *(d4 *)(to + 4 * m);
        }
        at = to;
      }
      for (int m = 0; m < BLOCK; m++, w += 4) {
        const f4 v = load4(w) * t[0] + load4(w + COLUMNS) * t[1] THIRD(+ load4(w + 2 * COLUMNS) * t[2]);
        sum[m] += __builtin_convertvector(v, d4);
      }
    }
  for (int m = 0; m < BLOCK; m++) *(d4 *)(at + 4 * m) = sum[m];
}

void coarse_image_subtract(const CoarseSpace *c, const float *y, float *r) {
  for (int i = 0; i < c->rows; i++, r += BLOCK)
    for (int s = c->pair_start[i]; s < c->pair_start[i + 1]; s++) {
      const float *w = c->image + (long)BLOCK * COLUMNS * s, *of = y + COLUMNS * (long)c->pair_subdomain[s];
      for (int k = 0; k < BLOCK; k++, w += COLUMNS) {
        const f4 v = load4(w) * load4(of) + load4(w + 4) * load4(of + 4) THIRD(+ load4(w + 8) * load4(of + 8));
        r[k] -= (v[0] + v[2]) + (v[1] + v[3]);
      }
    }
}

void coarse_restrict(const CoarseSpace *c, const float *r, double *y) {
  for (long i = 0; i < c->rows; i++)
    for (int a = 0; a < COLUMNS; a++)
      y[COLUMNS * (long)c->subdomain[i] + a] += (double)c->functions[COLUMNS * i + a] * r[BLOCK * i + a / 4];
}

void coarse_prolong(const CoarseSpace *c, const float *y, float *x) {
  for (long i = 0; i < c->rows; i++)
    for (int a = 0; a < COLUMNS; a++)
      x[BLOCK * i + a / 4] += c->functions[COLUMNS * i + a] * y[COLUMNS * (long)c->subdomain[i] + a];
}

void matrix_coupled_unknowns(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, unsigned char *coupled) {
  for (int i = 0; i < b->rows; i++) {
    const long all = (long)BLOCK * (b->aij_start[i + 1] - b->aij_start[i]);
    for (int r = 0; r < BLOCK; r++) {
      const double *row = values + b->aij_offset[i] + r * (long)b->aij_stride[i];
      const long diagonal = (long)BLOCK * b->aij_diagonal[i] + r;
      int any = 0;
      for (long k = 0; k < all && !any; k++) any = k != diagonal && row[k] != 0;
      if (b->off_diagonal_start)
        for (int k = b->off_diagonal_start[i]; k < b->off_diagonal_start[i + 1] && !any; k++) {
          const double *block = off_diagonal + b->off_diagonal_value[k] + r * (long)b->off_diagonal_stride[i];
          any = block[0] != 0 || block[1] != 0 THIRD(|| block[2] != 0);
        }
      coupled[(long)BLOCK * i + r] = any;
    }
  }
}
