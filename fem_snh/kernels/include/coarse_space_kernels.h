/* The functions of coarse_space_api.h. COLUMNS is BLOCK components times the four lanes of f4. */
typedef double d4 __attribute__((vector_size(32), aligned(8)));

/* sum[BLOCK][BLOCK] += block * g: a block whose rows are `down` doubles apart, its columns `right`, times a node's functions,
 * times `scale`. */
static inline __attribute__((always_inline)) void add_image(d4 *sum, const double *block, long down, long right, double scale, const float *functions) {
  d4 g[BLOCK];
  for (int k = 0; k < BLOCK; k++) g[k] = scale * __builtin_convertvector(load4(functions + 4 * k), d4);
  for (int r = 0; r < BLOCK; r++)
    for (int k = 0; k < BLOCK; k++) sum[BLOCK * r + k] += block[down * r + right * k] * g[k];
}

/* The position of the pair (row, subdomain) among the pairs of the row. */
static inline int find_pair(const CoarseSpace *c, int row, int subdomain) {
  int at = c->pair_start[row];
  while (c->pair_subdomain[at] != subdomain) at++;
  return at - c->pair_start[row];
}

/* Add subdomain s to the ascending list of a row, of which there are n so far; return their number. */
static inline int add_pair(int *list, int n, int s) {
  int at = n;
  while (at > 0 && list[at - 1] > s) at--;
  if (at > 0 && list[at - 1] == s) return n;
  for (int k = n; k > at; k--) list[k] = list[k - 1];
  list[at] = s;
  return n + 1;
}

int coarse_pairs(const SymmetricBlockMatrix *b, const int *start, const int *column, const int *subdomain, int *list, int *pair_start, int *pair_subdomain) {
  pair_start[0] = 0;
  for (int i = 0; i < b->rows; i++) {
    int n = 0;
    for (int k = start[i]; k < start[i + 1]; k++) n = add_pair(list, n, subdomain[column[k]]);
    for (int k = b->off_diagonal_start ? b->off_diagonal_start[i] : 0; b->off_diagonal_start && k < b->off_diagonal_start[i + 1]; k++)
      n = add_pair(list, n, subdomain[b->rows + b->off_diagonal_column[k]]);
    for (int k = 0; pair_subdomain && k < n; k++) pair_subdomain[pair_start[i] + k] = list[k];
    pair_start[i + 1] = pair_start[i] + n;
  }
  return pair_start[b->rows];
}

/* The sum of blocks whose columns are in one subdomain, in registers, on its way to the sums of that pair in `acc`, where
 * pair p is at p & mask. */
typedef struct { d4 sum[ENTRIES], *acc; int mask, pair; } PairSum;

static inline __attribute__((always_inline)) void move_to_pair(PairSum *s, int pair) {
  if (pair == s->pair) return;
  d4 *from = s->acc + ENTRIES * (s->pair & s->mask), *to = s->acc + ENTRIES * (pair & s->mask);
  for (int m = 0; m < ENTRIES && s->pair >= 0; m++) from[m] = s->sum[m];
  for (int m = 0; m < ENTRIES && pair >= 0; m++) s->sum[m] = to[m];
  s->pair = pair;
}

/* Add the blocks of row i in other ranks' columns to its sums, store its part of A Z, and add to E. */
static inline void finish_image(const SymmetricBlockMatrix *b, const CoarseSpace *c, int i, const double *off_diagonal, double scale, d4 *acc, double *E) {
  const int pairs = c->pair_start[i + 1] - c->pair_start[i];
  for (int k = b->off_diagonal_start ? b->off_diagonal_start[i] : 0; b->off_diagonal_start && k < b->off_diagonal_start[i + 1]; k++) {
    const int j = c->rows + b->off_diagonal_column[k];
    double block[ENTRIES];
    load_ghost_block(b, off_diagonal, i, k, block);
    add_image(acc + ENTRIES * find_pair(c, i, c->subdomain[j]), block, BLOCK, 1, scale, c->functions + COLUMNS * (long)j);
  }
  const float *g = c->functions + COLUMNS * (long)i;
  for (int s = 0; s < pairs; s++) {
    const d4 *at = acc + ENTRIES * s;
    float *image = c->image + (long)BLOCK * COLUMNS * (c->pair_start[i] + s);
    for (int m = 0; m < ENTRIES; m++) *(f4 *)(image + 4 * m) = __builtin_convertvector(at[m], f4);
    double *to = E + COLUMNS * COLUMNS * (long)c->pair_block[c->pair_start[i] + s];
    for (int a = 0; a < COLUMNS; a++)
      for (int m = 0; m < BLOCK; m++) *(d4 *)(to + COLUMNS * a + 4 * m) += (double)g[a] * at[BLOCK * (a / 4) + m];
  }
}

void coarse_assemble(const SymmetricBlockMatrix *b, const CoarseSpace *c, const double *values, const double *off_diagonal,
                     double scale, double *E) {
  for (int i = 0; i < c->rows; i++) {
    const int pairs = c->pair_start[i + 1] - c->pair_start[i], all = b->aij_start[i + 1] - b->aij_start[i];
    d4 acc[ENTRIES * pairs];
    memset(acc, 0, sizeof acc);
    PairSum s = {.acc = acc, .mask = -1, .pair = -1};
    const double *row = values + b->aij_offset[i];
    for (int k = 0; k < all; k++) {
      const int j = b->aij_column[b->aij_start[i] + k];
      prefetch_after(row + ENTRIES * k);
      move_to_pair(&s, find_pair(c, i, c->subdomain[j]));
      add_image(s.sum, row + BLOCK * k, b->aij_stride[i], 1, scale, c->functions + COLUMNS * (long)j);
    }
    move_to_pair(&s, -1);
    finish_image(b, c, i, off_diagonal, scale, acc, E);
  }
}

int coarse_window(const SymmetricBlockMatrix *b, const CoarseSpace *c, int *bandwidth) {
  int most = 1, window = 1;
  *bandwidth = 0;
  for (int k = 0; k < b->rows; k++)
    for (int m = b->upper_start[k]; m < b->upper_start[k + 1]; m++) {
      const int i = b->order[k], j = b->upper_column[m], distance = i < j ? j - i : i - j;
      *bandwidth = distance > *bandwidth ? distance : *bandwidth;
    }
  for (int i = 0; i < b->rows; i++) {
    const int first = i > *bandwidth ? i - *bandwidth : 0, last = i + *bandwidth + 1;
    const int pairs = c->pair_start[last < b->rows ? last : b->rows] - c->pair_start[first];
    most = pairs > most ? pairs : most;
  }
  while (window < most) window *= 2;
  return window;
}

void coarse_assemble_half(const SymmetricBlockMatrix *b, const CoarseSpace *c, int bandwidth, int window, double *sums, double *E) {
  d4 *ring = (d4 *)sums;
  for (int i = 0; i < b->rows + bandwidth; i++) {
    if (i < b->rows) {
      const int k = b->place[i], first = b->upper_start[k], n = b->upper_start[k + 1] - first;
      const long length = (long)BLOCK * n;
      const float *high = b->upper + ENTRIES * first, *g = c->functions + COLUMNS * (long)i;
      const int *rest = b->upper_rest + ENTRIES * first;
      PairSum s = {.acc = ring, .mask = window - 1, .pair = -1};
      double row[4 * BLOCK * (n + 1)], *block = row + 4 * BLOCK * n;
      load_diagonal(b, NULL, i, block);
      move_to_pair(&s, c->pair_start[i] + find_pair(c, i, c->subdomain[i]));
      add_image(s.sum, block, BLOCK, 1, 1, g);
      for (int m = 0; m < n; m++) {
        const int j = b->upper_column[first + m];
        prefetch_after(high + ENTRIES * m);
        prefetch_after(rest + ENTRIES * m);
        load_split(high + BLOCK * m, rest + BLOCK * m, length, row + 4 * BLOCK * m);
        move_to_pair(&s, c->pair_start[i] + find_pair(c, i, c->subdomain[j]));
        add_image(s.sum, row + 4 * BLOCK * m, 4, 1, 1, c->functions + COLUMNS * (long)j);
      }
      move_to_pair(&s, -1);
      for (int m = 0; m < n; m++) { /* the transposes: apart, as the processor has registers for one block of sums */
        const int j = b->upper_column[first + m], to = c->pair_start[j] + find_pair(c, j, c->subdomain[i]);
        add_image(ring + ENTRIES * (to & (window - 1)), row + 4 * BLOCK * m, 1, 4, 1, g);
      }
    }
    const int done = i - bandwidth; /* no row after i adds to this one */
    if (done < 0) continue;
    const int pairs = c->pair_start[done + 1] - c->pair_start[done];
    d4 acc[ENTRIES * pairs];
    for (int s = 0; s < pairs; s++) {
      d4 *from = ring + ENTRIES * ((c->pair_start[done] + s) & (window - 1));
      for (int m = 0; m < ENTRIES; m++) acc[ENTRIES * s + m] = from[m], from[m] = (d4){0};
    }
    finish_image(b, c, done, NULL, 1, acc, E);
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

/* Whether all unknowns of a row are coupled. */
static inline int all_coupled(const unsigned char *any) { return any[0] & any[1] THIRD(& any[2]); }

/* Note which rows of a block have a nonzero entry; its diagonal counts unless `off`. */
static inline void note_rows(const double *block, int down, int right, int off, unsigned char *any) {
  for (int r = 0; r < BLOCK; r++)
    for (int c = 0; c < BLOCK; c++) any[r] |= block[down * r + right * c] != 0 && (!off || r != c);
}

/* Note the rows of U's row k, or its columns if `transposed`, as far as they are not known to be coupled. */
static inline void note_upper(const SymmetricBlockMatrix *b, long k, int transposed, unsigned char *coupled) {
  const long i = b->order[k], first = b->upper_start[k], length = (long)BLOCK * (b->upper_start[k + 1] - first);
  for (long m = first; m < b->upper_start[k + 1]; m++) {
    unsigned char *any = coupled + BLOCK * (transposed ? b->upper_column[m] : i);
    if (all_coupled(any)) {
      if (transposed) continue;
      return;
    }
    double block[4 * BLOCK];
    const long at = ENTRIES * first + BLOCK * (m - first);
    load_split(b->upper + at, b->upper_rest + at, length, block);
    note_rows(block, transposed ? 1 : 4, transposed ? 4 : 1, 0, any);
  }
}

void matrix_coupled_unknowns(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, unsigned char *coupled) {
  double block[ENTRIES];
  memset(coupled, 0, (long)BLOCK * b->rows);
  for (int k = 0; !values && k < b->rows; k++) note_upper(b, k, 0, coupled);
  for (int k = 0; !values && k < b->rows; k++) note_upper(b, k, 1, coupled);
  for (int i = 0; i < b->rows; i++) {
    unsigned char *any = coupled + (long)BLOCK * i;
    if (all_coupled(any)) continue;
    load_diagonal(b, values, i, block);
    note_rows(block, BLOCK, 1, 1, any);
    const double *row = values ? values + b->aij_offset[i] : NULL;
    for (int k = 0; row && k < b->aij_start[i + 1] - b->aij_start[i] && !all_coupled(any); k++)
      if (k != b->aij_diagonal[i]) note_rows(row + BLOCK * k, b->aij_stride[i], 1, 0, any);
    for (int n = b->off_diagonal_start ? b->off_diagonal_start[i] : 0; b->off_diagonal_start && n < b->off_diagonal_start[i + 1] && !all_coupled(any); n++) {
      load_ghost_block(b, off_diagonal, i, n, block);
      note_rows(block, BLOCK, 1, 0, any);
    }
  }
}
