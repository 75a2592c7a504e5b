/* The functions of block_matrix_api.h: two sweeps and a vector update are one iteration of SSOR-preconditioned
 * conjugate gradients in the form of Eisenstat 1981, in which the product with A costs nothing beyond the
 * preconditioner's two triangular solves. */

/* The fraction of the absolute row sums of R that is added to D. With 1, M bounds A, as the smoothers of Baker et al.
 * 2011 do; 0.35 takes the fewest iterations (docs/results/scaling.md). */
#define REMAINDER_WEIGHT 0.35f

/* How far ahead of a loop over blocks their values are prefetched [bytes]. A block row is BLOCK rows of values, and the
 * processor follows each of them, but not beyond the end of the block row. Any distance from 2 to 8 kB takes the same
 * time (docs/results/speed.md). */
#define AHEAD 4096
static inline void prefetch_after(const void *at) { __builtin_prefetch((const char *)at + AHEAD); }
static inline void prefetch_before(const void *at) { __builtin_prefetch((const char *)at - AHEAD); }

/* The code of a third component, if a block has three. */
#if BLOCK == 3
#define THIRD(...) __VA_ARGS__
#else
#define THIRD(...)
#endif

typedef float f4 __attribute__((vector_size(16), aligned(4)));

/* Entry (r, c) of a block extended to 3x3 by the unit matrix. */
static inline double entry(const float *a, int r, int c) { return r < BLOCK && c < BLOCK ? a[BLOCK * r + c] : r == c; }

/* b = a^-1 for a symmetric block a. Returns 0 if a is not positive definite to single precision. If a is nearly
 * singular, such as at a node without stiffness in a clamped Hessian, e is added to its diagonal: the size of its
 * rounding errors (1e-6 of its trace; 1e-12 of `largest`, the matrix's largest entry). */
static inline int invert_block(double largest, float *a, float *b) {
  double trace = 0;
  for (int k = 0; k < BLOCK; k++) trace += a[(BLOCK + 1) * k];
  const double e = fmax(1e-6 * fabs(trace), 1e-12 * largest);
  for (int attempt = 0; attempt < 2; attempt++) {
    const double p = entry(a, 0, 0), q = entry(a, 1, 1), r = entry(a, 2, 2);
    const double x = entry(a, 1, 2), y = entry(a, 0, 2), z = entry(a, 0, 1);
    const double m = p * q - z * z, det = r * m - p * x * x - q * y * y + 2 * x * y * z;
    if (p > e / 2 && m > e / 2 * p && det > e / 2 * m) {
      const float xx = (q * r - x * x) / det, yy = (p * r - y * y) / det, zz = m / det;
      const float xy = (x * y - r * z) / det, xz = (x * z - q * y) / det, yz = (y * z - p * x) / det;
      const float inverse[3][3] = {{xx, xy, xz}, {xy, yy, yz}, {xz, yz, zz}};
      for (int k = 0; k < BLOCK; k++)
        for (int c = 0; c < BLOCK; c++) b[BLOCK * k + c] = inverse[k][c];
      return 1;
    }
    for (int k = 0; k < BLOCK; k++) a[(BLOCK + 1) * k] += e;
  }
  return 0;
}

void matrix_stages(int rows, const int *start, const int *column, int higher, float *stage) {
  for (long i = 0; i < rows; i++) {
    const int first = start[i], end = start[i + 1];
    int lower = 0;
    for (int k = first; k < end; k++) lower |= column[k] < higher;
    for (int c = 0; c < BLOCK; c++) stage[BLOCK * i + c] = first == end ? INTERIOR : lower ? LATE : EARLY;
  }
}

/* The index of block (i, j) among the blocks of `aij_column`; it must be there. */
static inline int find_block(const SymmetricBlockMatrix *b, int i, int j) {
  int low = b->aij_start[i], high = b->aij_start[i + 1] - 1;
  while (low < high) {
    const int middle = (low + high) / 2;
    if (b->aij_column[middle] < j) low = middle + 1;
    else high = middle;
  }
  return low;
}

int matrix_order(const SymmetricBlockMatrix *b, const float *stage, const int *offsets) {
  const int *columns = b->aij_column;
  const int rows = b->rows, blocks = b->aij_start[rows];
  int at = 0, upper = 0;
  for (int s = EARLY; s <= LATE; s++) {
    b->stage_start[s] = at;
    for (long i = 0; i < rows; i++)
      if (stage[BLOCK * i] == s) b->order[at++] = i;
  }
  b->stage_start[LATE + 1] = at;
  for (int k = 0; k < rows; k++) {
    const long i = b->order[k];
    b->upper_start[k] = upper;
    b->aij_diagonal[i] = -1;
    for (int n = b->aij_start[i]; n < b->aij_start[i + 1]; n++) {
      const long j = columns[n];
      const float later = stage[BLOCK * j] - stage[BLOCK * i];
      if (j == i) b->aij_diagonal[i] = n - b->aij_start[i];
      if (later < 0 || (later == 0 && j <= i)) continue;
      if (upper >= (blocks - rows) / 2) return 1;
      b->upper_column[upper] = j;
      if (offsets) b->upper_value[upper] = offsets[n];
      upper++;
    }
    if (b->aij_diagonal[i] < 0) return 1;
  }
  b->upper_start[rows] = upper;
  if (upper != (blocks - rows) / 2) return 1;
  for (int k = 0; b->place && k < rows; k++) {
    const int i = b->order[k], first = b->upper_start[k];
    b->place[i] = k;
    b->half_offset[b->aij_start[i] + b->aij_diagonal[i]] = ENTRIES * i;
    for (int m = first; m < b->upper_start[k + 1]; m++) {
      const int j = b->upper_column[m], mirror = find_block(b, j, i);
      if (columns[mirror] != i) return 1;
      b->half_offset[mirror] = -1;
      b->half_offset[find_block(b, i, j)] = ENTRIES * first + BLOCK * (m - first);
    }
  }
  return 0;
}

/* Whether row k in the order of the sweeps is coupled to the next one by a block that the sweeps apply by `link`. In a
 * sweep over 2x2 blocks each row waits for the solution of the row before. `link` updates its right-hand side directly
 * from the right-hand side before, by one product instead of two with a store and a load. This wait does not limit
 * larger blocks. A stage's last row has no link. */
static inline int is_linked(const SymmetricBlockMatrix *b, long k) {
  return BLOCK == 2 && k + 1 != b->stage_start[INTERIOR] && k + 1 != b->stage_start[LATE] &&
         b->upper_start[k] < b->upper_start[k + 1] && b->upper_column[b->upper_start[k]] == b->order[k + 1];
}

/* Set link k + 1, U_ij transposed times D_i^-1 with i and j the rows k and k + 1 in the order of the sweeps. */
static inline void set_link(const SymmetricBlockMatrix *b, long k) {
  const float *d = b->diagonal_inverse + (long)ENTRIES * b->order[k], *u = b->upper + (long)ENTRIES * b->upper_start[k];
  const long length = (long)BLOCK * (b->upper_start[k + 1] - b->upper_start[k]);
  for (int m = 0; m < 4; m++) b->link[4 * (k + 1) + m] = u[m % 2] * d[m / 2] + u[length + m % 2] * d[2 + m / 2];
}

/* The block on the diagonal in row i, from an AIJ matrix or, for NULL, the stored one. */
static inline void load_diagonal(const SymmetricBlockMatrix *b, const double *values, long i, double *block) {
  const double *from = values ? values + b->aij_offset[i] + (long)BLOCK * b->aij_diagonal[i] : NULL;
  const float *high = b->own_diagonal + ENTRIES * i;
  const int *rest = b->own_diagonal_rest + ENTRIES * i;
  for (int m = 0; m < ENTRIES; m++)
    block[m] = from ? from[m / BLOCK * (long)b->aij_stride[i] + m % BLOCK] : join(high[m], rest[m]);
}

/* The values of block k of row i in other ranks' columns, likewise. */
static inline __attribute__((always_inline)) void load_ghost_block(const SymmetricBlockMatrix *b, const double *values, int i, int k, double *block) {
  const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
  for (int r = 0; r < BLOCK; r++)
    for (int c = 0; c < BLOCK; c++) {
      const long at = ENTRIES * first + (long)BLOCK * (n * r + k - first) + c;
      block[BLOCK * r + c] = values ? values[b->off_diagonal_value[k] + r * (long)b->off_diagonal_stride[i] + c]
                                    : join(b->off_diagonal[at], b->off_diagonal_rest[at]);
    }
}

/* Copy row k of U in the order of the sweeps, and add it and its transpose to `translations`. Its blocks ascend in the
 * AIJ matrix, and are mostly contiguous there. */
static inline void fill_upper(const SymmetricBlockMatrix *b, long k, const double *values, double scale, double *translations) {
  const int first = b->upper_start[k], n = b->upper_start[k + 1] - first;
  if (!n) return;
  const int *at = b->upper_value + first;
  const long stride = b->aij_stride[b->order[k]], length = (long)BLOCK * n;
  const int contiguous = at[n - 1] - at[0] == length - BLOCK;
  float *u = b->upper + ENTRIES * first;
  for (int r = 0; r < BLOCK; r++, u += length) {
    const double *row = values + r * stride;
    double sum = 0;
    for (int m = 0; m < n; m++) {
      const double *block = row + (contiguous ? at[0] + (long)BLOCK * m : at[m]);
      prefetch_after(block);
      for (int c = 0; c < BLOCK; c++) u[BLOCK * m + c] = block[c] * scale;
      sum += block[r];
    }
    translations[r] += 2 * sum * scale;
  }
}

/* Add row k of U and its transpose to `translations`. */
static inline void add_translations(const SymmetricBlockMatrix *b, long k, double *translations) {
  const int first = b->upper_start[k], n = b->upper_start[k + 1] - first;
  const float *high = b->upper + ENTRIES * first;
  const int *rest = b->upper_rest + ENTRIES * first;
  for (int r = 0; r < BLOCK; r++, high += (long)BLOCK * n, rest += (long)BLOCK * n) {
    double sum = 0;
    for (int m = 0; m < n; m++) {
      prefetch_after(high + BLOCK * m);
      prefetch_after(rest + BLOCK * m);
      sum += join(high[BLOCK * m + r], rest[BLOCK * m + r]);
    }
    translations[r] += 2 * sum;
  }
}

long matrix_fill(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, double scale,
                 double *translations) {
  long bad = 0;
  for (int k = 0; k < BLOCK; k++) translations[k] = 0;
  const double factor = values ? scale : 1;
  for (int i = 0; i < b->rows; i++) {
    double block[ENTRIES];
    load_diagonal(b, values, i, block);
    for (int m = 0; m < ENTRIES; m++) b->diagonal[ENTRIES * i + m] = block[m] * factor;
    for (int r = 0; r < BLOCK; r++) translations[r] += block[(BLOCK + 1) * r] * factor;
    if (values) fill_upper(b, i, values, scale, translations);
    else add_translations(b, i, translations);
  }
  for (int i = 0; b->off_diagonal_start && i < b->rows; i++) {
    const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
    for (int k = 0; k < n; k++) {
      double block[ENTRIES];
      load_ghost_block(b, off_diagonal, i, first + k, block);
      for (int r = 0; r < BLOCK; r++) {
        float *to = b->off_diagonal + ENTRIES * first + (long)BLOCK * (r * n + k);
        for (int c = 0; values && c < BLOCK; c++) to[c] = block[BLOCK * r + c] * scale;
        translations[r] += block[(BLOCK + 1) * r] * factor;
      }
    }
  }
  for (int at = b->stage_start[LATE]; at < b->rows; at++) {
    const int i = b->order[at], first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
    for (int r = 0; r < BLOCK; r++) {
      float sum = 0;
      for (int k = 0; k < n; k++)
        for (int c = 0; c < BLOCK && b->ghost_stage[b->off_diagonal_column[first + k]] == LATE; c++)
          sum += fabsf(b->off_diagonal[ENTRIES * first + (long)BLOCK * (r * n + k) + c]);
      b->shift[(long)BLOCK * i + r] = REMAINDER_WEIGHT * sum;
      b->diagonal[ENTRIES * i + (BLOCK + 1) * r] += REMAINDER_WEIGHT * sum;
    }
  }
  for (long i = 0; i < b->rows; i++) bad += !invert_block(b->largest, b->diagonal + ENTRIES * i, b->diagonal_inverse + ENTRIES * i);
  for (long k = 0; k < b->rows; k++)
    if (is_linked(b, k)) set_link(b, k);
  return bad;
}

double matrix_largest_diagonal(const SymmetricBlockMatrix *b, const double *values) {
  double most = 0;
  for (int i = 0; i < b->rows; i++) {
    double block[ENTRIES];
    load_diagonal(b, values, i, block);
    for (int k = 0; k < BLOCK; k++) {
      if (!isfinite(block[(BLOCK + 1) * k])) return INFINITY;
      most = fmax(most, fabs(block[(BLOCK + 1) * k]));
    }
  }
  return most;
}

/* The sweeps work on vectors of four lanes per node, so that one load reads what one store has just written. Lanes
 * beyond the BLOCK components hold values of the next block, and are never used. */
static inline f4 load_node(const float *x) { return (f4){x[0], x[1], THIRD(x[2])}; }
static inline void store_node(float *to, f4 x) { for (int c = 0; c < BLOCK; c++) to[c] = x[c]; }
static inline f4 load4(const float *x) { return *(const f4 *)x; }

/* The sum of the lanes of a node's components. */
static inline float sum_lanes(f4 x) { return (x[0] + x[1]) THIRD(+ x[2]); }

/* m x for a symmetric block m, whose rows are loaded as columns. */
static inline f4 multiply_block(const float *m, f4 x) {
  return load4(m) * x[0] + load4(m + BLOCK) * x[1] THIRD(+ load4(m + 2 * BLOCK) * x[2]);
}

/* The products of a link m and of its transpose with the values x of a node. */
static inline f4 multiply_link(const float *m, f4 x) { return load4(m) * x[0] + (f4){m[2], m[3]} * x[1]; }
static inline f4 multiply_link_transposed(const float *m, f4 x) { return (f4){m[0], m[2]} * x[0] + (f4){m[1], m[3]} * x[1]; }

/* The product of row i's blocks in the columns of other ranks' early (or late) nodes with their values. */
static inline f4 multiply_ghosts(const SymmetricBlockMatrix *b, int i, int stage, const float *values) {
  f4 s = {0};
  const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
  const float *row = b->off_diagonal + ENTRIES * first;
  for (int k = 0; k < n; k++, row += BLOCK) {
    const int ghost = b->off_diagonal_column[first + k];
    if (b->ghost_stage[ghost] != stage) continue;
    const float *x = values + (long)BLOCK * ghost;
    for (int r = 0; r < BLOCK; r++)
      for (int c = 0; c < BLOCK; c++) s[r] += row[(long)BLOCK * n * r + c] * x[c];
  }
  return s;
}

/* One stage of the forward substitution for one or two right-hand sides in `lanes`, [rows][sides][4]. The solutions y
 * replace them: row i is final when it is reached, and L_ki y_i is then subtracted from the later rows k of this rank.
 * L_ki is the transpose of the stored U_ik. */
static inline __attribute__((always_inline)) void solve_lower_lanes(const SymmetricBlockMatrix *b, const int stage, const int sides) {
  f4 last[2] = {{0}, {0}};
  for (int at = b->stage_start[stage]; at < b->stage_start[stage + 1]; at++) {
    const int i = b->order[at], first = b->upper_start[at], n = b->upper_start[at + 1] - first;
    const long length = (long)BLOCK * n;
    const float *values = b->upper + ENTRIES * first, *u = values;
    const int linked = is_linked(b, at);
    f4 y[2];
    for (int s = 0; s < sides; s++) {
      float *own = b->lanes + 4L * (sides * i + s);
      f4 right = load4(own);
      if (stage == LATE) right -= multiply_ghosts(b, i, EARLY, s ? b->other_ghosts : b->ghosts);
      if (BLOCK == 2) last[s] = right -= multiply_link(b->link + 4 * at, last[s]);
      *(f4 *)own = y[s] = multiply_block(b->diagonal_inverse + ENTRIES * i, right);
    }
    u += BLOCK * linked;
    for (int k = linked; k < n; k++, u += BLOCK) {
      prefetch_after(values + ENTRIES * k);
      const f4 u0 = load4(u), u1 = load4(u + length) THIRD(, u2 = load4(u + 2 * length));
      float *to = b->lanes + 4L * sides * b->upper_column[first + k];
      for (int s = 0; s < sides; s++) {
        const f4 product = u0 * y[s][0] + u1 * y[s][1] THIRD(+ u2 * y[s][2]);
        *(f4 *)(to + 4 * s) -= product;
      }
    }
  }
}

double matrix_solve_lower(const SymmetricBlockMatrix *b, int stage, float *w) {
  for (long i = 0; stage == EARLY && i < b->rows; i++) *(f4 *)(b->lanes + 4 * i) = load_node(w + BLOCK * i);
  solve_lower_lanes(b, stage, 1);
  for (long at = b->stage_start[stage]; at < b->stage_start[stage + 1]; at++) {
    const long i = b->order[at];
    store_node(w + BLOCK * i, load4(b->lanes + 4 * i));
  }
  return 0;
}

double matrix_solve_lower_both(const SymmetricBlockMatrix *b, int stage, float *w, float *y) {
  for (long i = 0; stage == EARLY && i < b->rows; i++) {
    *(f4 *)(b->lanes + 8 * i) = load_node(w + BLOCK * i);
    *(f4 *)(b->lanes + 8 * i + 4) = load_node(y + BLOCK * i);
  }
  solve_lower_lanes(b, stage, 2);
  for (long at = b->stage_start[stage]; at < b->stage_start[stage + 1]; at++) {
    const long i = b->order[at];
    store_node(w + BLOCK * i, load4(b->lanes + 8 * i));
    store_node(y + BLOCK * i, load4(b->lanes + 8 * i + 4));
  }
  double norm_squared = 0;
  for (long i = 0; stage == LATE && i < b->rows; i++) {
    const f4 solution = load4(b->lanes + 8 * i + 4), z = multiply_block(b->diagonal + ENTRIES * i, solution);
    for (int c = 0; c < BLOCK; c++) norm_squared += (double)solution[c] * z[c];
  }
  return norm_squared;
}

double matrix_multiply_lower(const SymmetricBlockMatrix *b, int stage, const float *w, double factor, double *y) {
  if (stage == EARLY) memset(b->lanes, 0, 16L * b->rows);
  for (long at = b->stage_start[stage]; at < b->stage_start[stage + 1]; at++) {
    const int first = b->upper_start[at], n = b->upper_start[at + 1] - first;
    const long i = b->order[at], length = (long)BLOCK * n;
    const float *u = b->upper + ENTRIES * first;
    const f4 x = load_node(w + BLOCK * i);
    f4 sum = load4(b->lanes + 4 * i) + multiply_block(b->diagonal + ENTRIES * i, x);
    if (stage == LATE) sum += multiply_ghosts(b, i, EARLY, b->ghosts);
    for (int c = 0; c < BLOCK; c++) y[BLOCK * i + c] = factor * sum[c];
    for (int k = 0; k < n; k++, u += BLOCK) {
      float *to = b->lanes + 4L * b->upper_column[first + k];
      *(f4 *)to += load4(u) * x[0] + load4(u + length) * x[1] THIRD(+ load4(u + 2 * length) * x[2]);
    }
  }
  return 0;
}

/* The nodes that were computed last enter a row's sums last, so that the processor adds the other nodes before they
 * are known. Two sums for each component halve the chain of additions. */
double matrix_backward_sweep(const SymmetricBlockMatrix *b, int stage, float beta, const float *z, float *p, float *t, float *w) {
  f4 next = {0};
  for (long at = b->stage_start[stage + 1] - 1; at >= b->stage_start[stage]; at--) {
    const int first = b->upper_start[at], n = b->upper_start[at + 1] - first;
    const long i = b->order[at], length = (long)BLOCK * n;
    const float *u = b->upper + ENTRIES * first;
    f4 x0 = {0}, y0 = {0}, THIRD(z0 = {0},) x1 = {0}, y1 = {0} THIRD(, z1 = {0});
    const int linked = is_linked(b, at);
    int k = n - 1;
    for (; k > linked; k -= 2) {
      prefetch_before(u + ENTRIES * k);
      prefetch_before(u + ENTRIES * (k - 1));
      const int *column = b->upper_column + first + k;
      const f4 t0 = load4(b->lanes + 4L * column[0]), t1 = load4(b->lanes + 4L * column[-1]);
      const float *u0 = u + (long)BLOCK * k, *u1 = u0 - BLOCK;
      x0 += load4(u0) * t0; y0 += load4(u0 + length) * t0; THIRD(z0 += load4(u0 + 2 * length) * t0;)
      x1 += load4(u1) * t1; y1 += load4(u1 + length) * t1; THIRD(z1 += load4(u1 + 2 * length) * t1;)
    }
    if (k == linked) {
      const f4 t1 = load4(b->lanes + 4L * b->upper_column[first + k]);
      const float *u1 = u + (long)BLOCK * k;
      x1 += load4(u1) * t1; y1 += load4(u1 + length) * t1; THIRD(z1 += load4(u1 + 2 * length) * t1;)
    }
    x0 += x1; y0 += y1; THIRD(z0 += z1;)
    f4 s = {sum_lanes(x0), sum_lanes(y0), THIRD(sum_lanes(z0))};
    if (stage == EARLY) s += multiply_ghosts(b, i, LATE, b->ghosts);
    const f4 direction = load_node(z + BLOCK * i) + beta * load_node(p + BLOCK * i);
    f4 solution = multiply_block(b->diagonal_inverse + ENTRIES * i, direction - s);
    if (linked) {
      solution -= multiply_link_transposed(b->link + 4 * (at + 1), next);
      s += (f4){u[0] * next[0] + u[1] * next[1], u[length] * next[0] + u[length + 1] * next[1]};
    }
    next = solution;
    *(f4 *)(b->lanes + 4 * i) = solution;
    store_node(p + BLOCK * i, direction); store_node(w + BLOCK * i, s); store_node(t + BLOCK * i, solution);
  }
  return 0;
}

double matrix_forward_sweep(const SymmetricBlockMatrix *b, int stage, const float *p, const float *t, const float *w, float *q) {
  for (long i = 0; stage == EARLY && i < b->rows; i++) *(f4 *)(b->lanes + 4 * i) = load_node(w + BLOCK * i);
  for (long at = b->stage_start[LATE]; stage == EARLY && at < b->rows; at++) {
    const long i = b->order[at];
    f4 sum = multiply_ghosts(b, i, LATE, b->ghosts);
    for (int r = 0; r < BLOCK; r++) sum[r] -= b->shift[BLOCK * i + r] * t[BLOCK * i + r];
    *(f4 *)(b->lanes + 4 * i) += sum;
  }
  solve_lower_lanes(b, stage, 1);
  for (long at = b->stage_start[EARLY]; stage == EARLY && at < b->stage_start[INTERIOR]; at++) {
    const long i = b->order[at];
    store_node(q + BLOCK * i, load4(b->lanes + 4 * i));
  }
  double dot = 0;
  for (long i = 0; stage == LATE && i < b->rows; i++) {
    const f4 value = load_node(t + BLOCK * i) + load4(b->lanes + 4 * i);
    store_node(q + BLOCK * i, value);
    for (int c = 0; c < BLOCK; c++) dot += (double)p[BLOCK * i + c] * value[c];
  }
  return dot;
}

double matrix_weighted_norm(const SymmetricBlockMatrix *b, const float *p) {
  double sum = 0;
  for (long i = 0; i < b->rows; i++, p += BLOCK)
    for (int r = 0; r < BLOCK; r++)
      for (int c = 0; c < BLOCK; c++) sum += (double)p[r] * b->diagonal_inverse[ENTRIES * i + BLOCK * r + c] * p[c];
  return sum;
}

double matrix_cg_update(const SymmetricBlockMatrix *b, float alpha, const float *t, const float *q, float *x, float *r, float *z) {
  double dot = 0;
  for (long i = 0; i < (long)BLOCK * b->rows; i += BLOCK) {
    const f4 residual = load_node(r + i) - alpha * load_node(q + i), product = multiply_block(b->diagonal + BLOCK * i, residual);
    store_node(x + i, load_node(x + i) + alpha * load_node(t + i));
    store_node(r + i, residual);
    store_node(z + i, product);
    for (int c = 0; c < BLOCK; c++) dot += (double)residual[c] * product[c];
  }
  return dot;
}

void matrix_pattern(const SymmetricBlockMatrix *b, int *start, int *column) {
  memset(start, 0, sizeof(int) * (b->rows + 1L));
  for (int k = 0; k < b->rows; k++) {
    start[b->order[k] + 1] += 1 + b->upper_start[k + 1] - b->upper_start[k];
    for (int m = b->upper_start[k]; m < b->upper_start[k + 1]; m++) start[b->upper_column[m] + 1]++;
  }
  for (int i = 0; i < b->rows; i++) start[i + 1] += start[i];
  if (!column) return;
  for (int k = 0; k < b->rows; k++) { /* start[i] is the next free place of row i, in the end that of row i + 1 */
    const int i = b->order[k];
    column[start[i]++] = i;
    for (int m = b->upper_start[k]; m < b->upper_start[k + 1]; m++) {
      column[start[i]++] = b->upper_column[m];
      column[start[b->upper_column[m]]++] = i;
    }
  }
  for (int i = b->rows; i > 0; i--) start[i] = start[i - 1];
  start[0] = 0;
  for (int i = 0; i < b->rows; i++)
    for (int n = start[i] + 1; n < start[i + 1]; n++) {
      const int j = column[n];
      int at = n;
      for (; at > start[i] && column[at - 1] > j; at--) column[at] = column[at - 1];
      column[at] = j;
    }
}

void matrix_scale(const SymmetricBlockMatrix *b, double factor) {
  const long own = ENTRIES * b->rows, upper = ENTRIES * b->upper_start[b->rows];
  const long others = b->off_diagonal_start ? ENTRIES * b->off_diagonal_start[b->rows] : 0;
  for (long k = 0; k < own; k++) b->own_diagonal[k] *= factor;
  for (long k = 0; k < upper; k++) b->upper[k] *= factor;
  for (long k = 0; k < others; k++) b->off_diagonal[k] *= factor;
}

/* The values of a block whose rows are `length` floats apart, in rows of 4 doubles. */
static inline __attribute__((always_inline)) void load_split(const float *high, const int *rest, long length, double *block) {
  for (int r = 0; r < BLOCK; r++) *(double4 *)(block + 4 * r) = join4(high + length * r, rest + length * r);
}

/* y += m x, with the absolute values of m if `absolute`; element (r, c) of m is at down r + right c. */
static inline void multiply_split(const double *m, int down, int right, int absolute, const double *x, double *y) {
  for (int r = 0; r < BLOCK; r++)
    for (int c = 0; c < BLOCK; c++) y[r] += (absolute ? fabs(m[down * r + right * c]) : m[down * r + right * c]) * x[c];
}

void matrix_multiply(const SymmetricBlockMatrix *b, int absolute, const double *x, const double *x_ghosts, double *y) {
  double block[4 * BLOCK];
  memset(y, 0, sizeof(double) * BLOCK * b->rows);
  for (long k = 0; k < b->rows; k++) {
    const int first = b->upper_start[k], n = b->upper_start[k + 1] - first;
    const long i = b->order[k], length = (long)BLOCK * n;
    const float *high = b->upper + ENTRIES * first;
    const int *rest = b->upper_rest + ENTRIES * first;
    load_split(b->own_diagonal + ENTRIES * i, b->own_diagonal_rest + ENTRIES * i, BLOCK, block);
    multiply_split(block, 4, 1, absolute, x + BLOCK * i, y + BLOCK * i);
    for (int m = 0; m < n; m++) {
      const long j = b->upper_column[first + m];
      prefetch_after(high + ENTRIES * m);
      prefetch_after(rest + ENTRIES * m);
      load_split(high + BLOCK * m, rest + BLOCK * m, length, block);
      multiply_split(block, 4, 1, absolute, x + BLOCK * j, y + BLOCK * i);
      multiply_split(block, 1, 4, absolute, x + BLOCK * i, y + BLOCK * j);
    }
  }
  for (long i = 0; b->off_diagonal_start && i < b->rows; i++)
    for (int k = b->off_diagonal_start[i]; k < b->off_diagonal_start[i + 1]; k++) {
      load_ghost_block(b, NULL, i, k, block);
      multiply_split(block, BLOCK, 1, absolute, x_ghosts + (long)BLOCK * b->off_diagonal_column[k], y + BLOCK * i);
    }
}

/* Write a block, (r, c) at down r + right c, to block (i, j) of an AIJ matrix. */
static inline void write_block(const SymmetricBlockMatrix *b, int i, int j, const double *block, int down, int right, double scale, double *values) {
  const long first = b->aij_start[i], length = (long)BLOCK * (b->aij_start[i + 1] - first);
  double *to = values + ENTRIES * first + BLOCK * (find_block(b, i, j) - first);
  for (int r = 0; r < BLOCK; r++)
    for (int c = 0; c < BLOCK; c++) to[length * r + c] = block[down * r + right * c] / scale;
}

void matrix_to_aij(const SymmetricBlockMatrix *b, double scale, double *values, double *off_diagonal) {
  double block[4 * BLOCK];
  for (int k = 0; k < b->rows; k++) {
    const int i = b->order[k], first = b->upper_start[k], n = b->upper_start[k + 1] - first;
    load_diagonal(b, NULL, i, block);
    write_block(b, i, i, block, BLOCK, 1, scale, values);
    for (int m = 0; m < n; m++) {
      const long at = ENTRIES * first + BLOCK * m;
      const int j = b->upper_column[first + m];
      load_split(b->upper + at, b->upper_rest + at, (long)BLOCK * n, block);
      write_block(b, i, j, block, 4, 1, scale, values);
      write_block(b, j, i, block, 1, 4, scale, values);
    }
  }
  const long others = b->off_diagonal_start ? ENTRIES * b->off_diagonal_start[b->rows] : 0;
  for (long k = 0; k < others; k++) off_diagonal[k] = join(b->off_diagonal[k], b->off_diagonal_rest[k]) / scale;
}
