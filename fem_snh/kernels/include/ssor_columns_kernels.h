/* The functions of ssor_columns_api.h: each entry of the matrix is read once for all lanes. A node has WIDTH floats. */
#define WIDTH ((long)BLOCK * LANES)
typedef float lanes_f __attribute__((vector_size(4 * LANES), aligned(4)));
typedef double lanes_d __attribute__((vector_size(8 * LANES), aligned(8)));

static inline lanes_f load(const float *x) { return *(const lanes_f *)x; }
static inline void store(float *to, lanes_f x) { *(lanes_f *)to = x; }
static inline lanes_d load_d(const double *x) { return *(const lanes_d *)x; }
static inline lanes_d widen(lanes_f x) { return __builtin_convertvector(x, lanes_d); }

/* y = m x for a symmetric block. */
static inline void multiply_lanes(const float *m, const lanes_f *x, lanes_f *y) {
  for (int r = 0; r < BLOCK; r++) {
    y[r] = m[r] * x[0];
    for (int c = 1; c < BLOCK; c++) y[r] += m[BLOCK * c + r] * x[c];
  }
}

void columns_solve_lower(const SymmetricBlockMatrix *b, float *w) {
  for (long i = 0; i < b->rows; i++) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = (long)BLOCK * n;
    const float *u = b->upper + ENTRIES * first;
    lanes_f right[BLOCK], y[BLOCK];
    for (int r = 0; r < BLOCK; r++) right[r] = load(w + WIDTH * i + LANES * r);
    multiply_lanes(b->diagonal_inverse + ENTRIES * i, right, y);
    for (int r = 0; r < BLOCK; r++) store(w + WIDTH * i + LANES * r, y[r]);
    for (int k = 0; k < n; k++, u += BLOCK) {
      float *at = w + WIDTH * b->upper_column[first + k];
      for (int c = 0; c < BLOCK; c++) {
        lanes_f product = u[c] * y[0];
        for (int r = 1; r < BLOCK; r++) product += u[length * r + c] * y[r];
        store(at + LANES * c, load(at + LANES * c) - product);
      }
    }
  }
}

void columns_multiply_lower(const SymmetricBlockMatrix *b, const float *w, float *y) {
  memset(y, 0, sizeof(float) * WIDTH * b->rows);
  for (long i = 0; i < b->rows; i++) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = (long)BLOCK * n;
    const float *u = b->upper + ENTRIES * first;
    lanes_f x[BLOCK], product[BLOCK];
    for (int r = 0; r < BLOCK; r++) x[r] = load(w + WIDTH * i + LANES * r);
    multiply_lanes(b->diagonal + ENTRIES * i, x, product);
    for (int r = 0; r < BLOCK; r++) store(y + WIDTH * i + LANES * r, load(y + WIDTH * i + LANES * r) + product[r]);
    for (int k = 0; k < n; k++, u += BLOCK) {
      float *at = y + WIDTH * b->upper_column[first + k];
      for (int c = 0; c < BLOCK; c++) {
        lanes_f sum = load(at + LANES * c);
        for (int r = 0; r < BLOCK; r++) sum += u[length * r + c] * x[r];
        store(at + LANES * c, sum);
      }
    }
  }
}

void columns_backward_sweep(const SymmetricBlockMatrix *b, const float *beta, const float *z, float *p, float *t, float *w) {
  const lanes_f factor = load(beta);
  for (long i = b->rows - 1; i >= 0; i--) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = (long)BLOCK * n, at = WIDTH * i;
    const float *u = b->upper + ENTRIES * first;
    lanes_f s[BLOCK], right[BLOCK], solution[BLOCK];
    for (int r = 0; r < BLOCK; r++) s[r] = (lanes_f){0};
    for (int k = n - 1; k >= 0; k--) {
      const float *from = t + WIDTH * b->upper_column[first + k], *v = u + (long)BLOCK * k;
      for (int c = 0; c < BLOCK; c++) {
        const lanes_f x = load(from + LANES * c);
        for (int r = 0; r < BLOCK; r++) s[r] += v[length * r + c] * x;
      }
    }
    for (int r = 0; r < BLOCK; r++) {
      const lanes_f direction = load(z + at + LANES * r) + factor * load(p + at + LANES * r);
      store(p + at + LANES * r, direction);
      right[r] = direction - s[r];
    }
    multiply_lanes(b->diagonal_inverse + ENTRIES * i, right, solution);
    for (int r = 0; r < BLOCK; r++) {
      store(t + at + LANES * r, solution[r]);
      store(w + at + LANES * r, s[r]);
    }
  }
}

void columns_forward_sweep(const SymmetricBlockMatrix *b, const float *p, const float *t, const float *ghosts, const float *w, float *q, double *dot) {
  for (long i = 0; i < b->rows; i++)
    for (int r = 0; r < BLOCK; r++) {
      lanes_f s = load(w + WIDTH * i + LANES * r);
      if (b->off_diagonal_start) {
        const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
        const float *row = b->off_diagonal + ENTRIES * first + (long)BLOCK * n * r;
        s -= b->shift[(long)BLOCK * i + r] * load(t + WIDTH * i + LANES * r);
        for (int k = 0; k < n; k++)
          for (int c = 0; c < BLOCK; c++)
            s += row[BLOCK * k + c] * load(ghosts + WIDTH * b->off_diagonal_column[first + k] + LANES * c);
      }
      store(q + WIDTH * i + LANES * r, s);
    }
  columns_solve_lower(b, q);
  lanes_d sum = {0};
  for (long i = 0; i < WIDTH * b->rows; i += LANES) {
    const lanes_f value = load(t + i) + load(q + i);
    store(q + i, value);
    sum += widen(load(p + i)) * widen(value);
  }
  *(lanes_d *)dot = sum;
}

void columns_update(const SymmetricBlockMatrix *b, const float *alpha, const float *t, const float *q, float *x, float *r, float *z, double *dot) {
  const lanes_f factor = load(alpha);
  lanes_d sum = {0};
  for (long i = 0; i < b->rows; i++) {
    lanes_f residual[BLOCK], product[BLOCK];
    for (int c = 0; c < BLOCK; c++) {
      const long at = WIDTH * i + LANES * c;
      residual[c] = load(r + at) - factor * load(q + at);
      store(r + at, residual[c]);
      store(x + at, load(x + at) + factor * load(t + at));
    }
    multiply_lanes(b->diagonal + ENTRIES * i, residual, product);
    for (int c = 0; c < BLOCK; c++) {
      store(z + WIDTH * i + LANES * c, product[c]);
      sum += widen(residual[c]) * widen(product[c]);
    }
  }
  *(lanes_d *)dot = sum;
}

void columns_image_transposed(const CoarseSpace *c, const float *t, double *y) {
  for (long i = 0; i < c->rows; i++, t += WIDTH)
    for (int s = c->pair_start[i]; s < c->pair_start[i + 1]; s++) {
      const float *w = c->image + (long)BLOCK * COLUMNS * s;
      double *to = y + LANES * COLUMNS * (long)c->pair_subdomain[s];
      for (int a = 0; a < COLUMNS; a++, to += LANES) {
        lanes_f v = w[a] * load(t);
        for (int k = 1; k < BLOCK; k++) v += w[COLUMNS * k + a] * load(t + LANES * k);
        *(lanes_d *)to = load_d(to) + widen(v);
      }
    }
}

void columns_image_subtract(const CoarseSpace *c, const float *y, float *r) {
  for (long i = 0; i < c->rows; i++, r += WIDTH)
    for (int s = c->pair_start[i]; s < c->pair_start[i + 1]; s++) {
      const float *w = c->image + (long)BLOCK * COLUMNS * s, *of = y + LANES * COLUMNS * (long)c->pair_subdomain[s];
      for (int k = 0; k < BLOCK; k++, w += COLUMNS) {
        lanes_f v = load(r + LANES * k);
        for (int a = 0; a < COLUMNS; a++) v -= w[a] * load(of + LANES * a);
        store(r + LANES * k, v);
      }
    }
}

void columns_restrict(const CoarseSpace *c, const float *r, double *y) {
  for (long i = 0; i < c->rows; i++)
    for (int a = 0; a < COLUMNS; a++) {
      double *to = y + LANES * (COLUMNS * (long)c->subdomain[i] + a);
      *(lanes_d *)to = load_d(to) + widen(c->functions[COLUMNS * i + a] * load(r + WIDTH * i + LANES * (a / 4)));
    }
}

void columns_prolong(const CoarseSpace *c, const float *y, float *x) {
  for (long i = 0; i < c->rows; i++)
    for (int a = 0; a < COLUMNS; a++) {
      float *to = x + WIDTH * i + LANES * (a / 4);
      store(to, load(to) + c->functions[COLUMNS * i + a] * load(y + LANES * (COLUMNS * (long)c->subdomain[i] + a)));
    }
}
