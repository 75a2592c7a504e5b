/* A coarse space on a matrix of 3x3 blocks: in each part of the nodes four functions of place, for
   each component of the displacement: twelve columns of Z. A node k has them in modes[k], (3, 4):
   by component; columns are numbered so, too. Z is as sparse as that; A Z is kept by node and part:
   a node has one for each part that it or a neighbour is in. */
typedef float f4 __attribute__((vector_size(16), aligned(4)));
typedef double d4 __attribute__((vector_size(32), aligned(8)));
enum { MODES = 12 };

typedef struct {
  int rows;
  const int *part; const float *modes; /* of own nodes, then of other ranks' */
  const int *column;                   /* the nodes of the AIJ matrix's blocks, own columns */
  const int *start; const int *near;   /* per row the range of its pairs, the parts in them */
  float *image;                        /* A Z: (pairs, 3, MODES) */
} Coarse;

static inline f4 load4(const float *x) { return *(const f4 *)x; }

/* acc (3, 3) += the 3x3 block whose rows are ``step`` apart, times a node's modes. */
static inline void add_block(d4 *acc, const double *block, long step, double scale, const float *g) {
  for (int r = 0; r < 3; r++)
    for (int k = 0; k < 3; k++)
      acc[3 * r + k] += block[step * r + k] * scale * __builtin_convertvector(load4(g + 4 * k), d4);
}

static inline int pair_of(const Coarse *c, int row, int part) {
  int at = c->start[row];
  while (c->near[at] != part) at++;
  return at - c->start[row];
}

/* A Z of the AIJ matrix's values (see fill), times scale; these rows' share of Z^T A Z goes to
   E (own parts * MODES, width), the first of the own parts being ``first``. */
void coarse_fill(const Blocks *b, const Coarse *c, const double *values, const double *far,
                 double scale, int first, double *E, long width) {
  for (int i = 0; i < c->rows; i++) {
    const int pairs = c->start[i + 1] - c->start[i], all = b->aij[i + 1] - b->aij[i];
    d4 acc[9 * pairs];
    memset(acc, 0, sizeof acc);
    const double *row = values + 9L * b->aij[i];
    for (int k = 0; k < all; k++) {
      const int j = c->column[b->aij[i] + k];
      add_block(acc + 9 * pair_of(c, i, c->part[j]), row + 3 * k, 3L * all, scale,
                c->modes + MODES * (long)j);
    }
    if (b->far_start) {
      const int from = b->far_start[i], n = b->far_start[i + 1] - from;
      for (int k = 0; k < n; k++) {
        const int j = c->rows + b->far_column[from + k];
        add_block(acc + 9 * pair_of(c, i, c->part[j]), far + 9L * from + 3 * k, 3L * n, scale,
                  c->modes + MODES * (long)j);
      }
    }
    const float *g = c->modes + MODES * (long)i;
    double *mine = E + (c->part[i] - first) * MODES * width;
    for (int s = 0; s < pairs; s++) {
      const d4 *at = acc + 9 * s;
      float *image = c->image + 3L * MODES * (c->start[i] + s);
      for (int m = 0; m < 9; m++) *(f4 *)(image + 4 * m) = __builtin_convertvector(at[m], f4);
      double *to = mine + MODES * (long)c->near[c->start[i] + s];
      for (int a = 0; a < MODES; a++)
        for (int m = 0; m < 3; m++)
          *(d4 *)(to + a * width + 4 * m) += (double)g[a] * at[3 * (a / 4) + m];
    }
  }
}

/* y += (A Z)^T t. */
void coarse_gather(const Coarse *c, const float *t, double *y) {
  for (int i = 0; i < c->rows; i++, t += 3)
    for (int s = c->start[i]; s < c->start[i + 1]; s++) {
      const float *w = c->image + 3L * MODES * s;
      double *to = y + MODES * (long)c->near[s];
      for (int m = 0; m < MODES; m += 4) {
        const f4 v = load4(w + m) * t[0] + load4(w + MODES + m) * t[1] + load4(w + 2 * MODES + m) * t[2];
        *(d4 *)(to + m) += __builtin_convertvector(v, d4);
      }
    }
}

/* r -= A Z y. */
void coarse_subtract(const Coarse *c, const float *y, float *r) {
  for (int i = 0; i < c->rows; i++, r += 3)
    for (int s = c->start[i]; s < c->start[i + 1]; s++) {
      const float *w = c->image + 3L * MODES * s, *of = y + MODES * (long)c->near[s];
      for (int k = 0; k < 3; k++, w += MODES) {
        const f4 v = load4(w) * load4(of) + load4(w + 4) * load4(of + 4) + load4(w + 8) * load4(of + 8);
        r[k] -= (v[0] + v[2]) + (v[1] + v[3]);
      }
    }
}

/* y += Z^T r. */
void coarse_restrict(const Coarse *c, const float *r, double *y) {
  for (long i = 0; i < c->rows; i++)
    for (int a = 0; a < MODES; a++)
      y[MODES * (long)c->part[i] + a] += (double)c->modes[MODES * i + a] * r[3 * i + a / 4];
}

/* x += Z y. */
void coarse_prolong(const Coarse *c, const float *y, float *x) {
  for (long i = 0; i < c->rows; i++)
    for (int a = 0; a < MODES; a++)
      x[3 * i + a / 4] += c->modes[MODES * i + a] * y[MODES * (long)c->part[i] + a];
}

/* Which unknowns the AIJ matrix couples to others: the rest are prescribed, or have no stiffness. */
void coupled(const Blocks *b, const double *values, const double *far, unsigned char *yes) {
  for (int i = 0; i < b->rows; i++) {
    const long all = 3L * (b->aij[i + 1] - b->aij[i]);
    const long others = b->far_start ? 3L * (b->far_start[i + 1] - b->far_start[i]) : 0;
    for (int r = 0; r < 3; r++) {
      const double *row = values + 9L * b->aij[i] + r * all;
      const long diagonal = 3L * b->middle[i] + r;
      int any = 0;
      for (long k = 0; k < all && !any; k++) any = k != diagonal && row[k] != 0;
      for (long k = 0; k < others && !any; k++) any = far[9L * b->far_start[i] + r * others + k] != 0;
      yes[3L * i + r] = any;
    }
  }
}
