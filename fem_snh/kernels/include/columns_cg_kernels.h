/* The functions of columns_cg_api.h. Every entry of the matrix is read once for all columns; the product with A
 * costs nothing beside the preconditioner's two triangular solves (Eisenstat 1981). LANES is defined by columns_cg.py. */
typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef double unaligned __attribute__((vector_size(8 * LANES), aligned(8)));

static inline lanes load(const double *values) { return *(const unaligned *)values; }
static inline void store(double *to, lanes values) { *(unaligned *)to = values; }

/* a / b lane by lane, 0 where b is not positive. */
static inline lanes ratio(const double *a, const double *b) {
  lanes quotient = {0};
  for (int l = 0; l < LANES; ++l) quotient[l] = b[l] > 0 ? a[l] / b[l] : 0;
  return quotient;
}

/* The sum of value[k] x[column[k]] over k in [from, to). */
static inline lanes row_product(const int *column, const double *value, int from, int to, const lanes *x) {
  lanes sum = {0};
  for (int k = from; k < to; ++k) sum += value[k] * x[column[k]];
  return sum;
}

#define VECTOR(name) lanes *const restrict name = (lanes *)c->name

void columns_start(const ColumnsCG *c, double *rho) {
  VECTOR(r);
  lanes sum = {0};
  for (int i = 0; i < c->rows; ++i) {
    r[i] -= row_product(c->column, c->value, c->start[i], c->diagonal[i], r);
    sum += r[i] * r[i];
  }
  memset(c->x, 0, c->rows * sizeof(lanes));
  memset(c->p, 0, c->rows * sizeof(lanes));
  store(rho, sum);
}

void columns_backward(const ColumnsCG *c, const double *rho, const double *previous) {
  VECTOR(r); VECTOR(p); VECTOR(t);
  const lanes beta = ratio(rho, previous);
  for (int i = c->rows - 1; i >= 0; --i) {
    p[i] = r[i] + beta * p[i];
    t[i] = p[i] - row_product(c->column, c->value, c->diagonal[i] + 1, c->start[i + 1], t);
  }
}

void columns_forward(const ColumnsCG *c, double *curvature) {
  VECTOR(p); VECTOR(t); VECTOR(w);
  const lanes *ghosts = (const lanes *)c->ghosts;
  lanes sum = {0};
  for (int i = 0; i < c->rows; ++i) {
    lanes v = p[i] - t[i];
    if (c->ghost_start) v += row_product(c->ghost_column, c->ghost_value, c->ghost_start[i], c->ghost_start[i + 1], ghosts);
    w[i] = v - row_product(c->column, c->value, c->start[i], c->diagonal[i], w);
    sum += p[i] * (t[i] + w[i]);
  }
  store(curvature, sum);
}

void columns_update(const ColumnsCG *c, const double *rho, const double *curvature, double *updated) {
  VECTOR(x); VECTOR(r); VECTOR(t); VECTOR(w);
  const lanes alpha = ratio(rho, curvature);
  lanes sum = {0};
  for (int i = 0; i < c->rows; ++i) {
    x[i] += alpha * t[i];
    r[i] -= alpha * (t[i] + w[i]);
    sum += r[i] * r[i];
  }
  store(updated, sum);
}
