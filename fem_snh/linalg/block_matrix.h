/* One rank's symmetric matrix of 3x3 blocks in single precision, A = L + D + L^T + (other ranks'
   columns), and the two sweeps of which Eisenstat's form of SSOR-preconditioned conjugate gradients
   consists (Eisenstat 1981): one multiplies by A and preconditions at the cost of a product.

   Only U = L^T is stored. A block row of n blocks is three rows of 3 n floats, each padded to whole
   vectors of eight; columns of the pads are never read. */
#include <math.h>
#include <string.h>

#define WIDEST 4096 /* blocks in a row, at most */
typedef float f8 __attribute__((vector_size(32), aligned(4)));

typedef struct {
  int rows;
  /* The pattern: per row the range of its blocks in U, their columns, and where its floats begin. */
  const int *start; const int *column; const long *place;
  /* Where a row of the AIJ matrix begins (in blocks), and which of its blocks is the diagonal one. */
  const int *aij; const int *middle;
  float *upper; float *diagonal; float *inverse; /* diagonal, inverse: (rows, 9) */
  /* Columns of other ranks: rows of blocks, unpadded. */
  const int *far_start; const int *far_column; float *far;
} Blocks;

static inline long padded(int blocks) { return (3L * blocks + 7) / 8 * 8; }

/* Inverse of a symmetric 3x3; 0 if it is not positive definite beyond the rounding of its values.
   One that is nearly singular, as of a clamped Hessian without stiffness at a node, gets what it
   lacks, of the size of that rounding. */
static inline int invert(float *a, float *b) {
  const double e = fmax(1e-6 * fabs((double)a[0] + a[4] + a[8]), 1e-12);
  for (int attempt = 0; attempt < 2; attempt++) {
    const double p = a[0], q = a[4], r = a[8], x = a[5], y = a[2], z = a[1];
    const double m = p * q - z * z, det = r * m - p * x * x - q * y * y + 2 * x * y * z;
    if (p > e / 2 && m > e / 2 * p && det > e / 2 * m) {
      b[0] = (q * r - x * x) / det; b[4] = (p * r - y * y) / det; b[8] = m / det;
      b[1] = b[3] = (x * y - r * z) / det;
      b[2] = b[6] = (x * z - q * y) / det;
      b[5] = b[7] = (y * z - p * x) / det;
      return 1;
    }
    for (int k = 0; k < 9; k += 4) a[k] += e;
  }
  return 0;
}

/* Take the values of the AIJ matrix (and of its columns of other ranks), times scale: the rows
   whose diagonal block is not positive definite. */
long fill(const Blocks *b, const double *values, const double *far, double scale) {
  long bad = 0;
  for (int i = 0; i < b->rows; i++) {
    const int all = b->aij[i + 1] - b->aij[i], n = b->start[i + 1] - b->start[i];
    const double *row = values + 9L * b->aij[i];
    float *u = b->upper + b->place[i], *d = b->diagonal + 9L * i;
    const long length = padded(n), from = 3L * b->middle[i];
    for (int k = 0; k < 3; k++, row += 3L * all) {
      for (int c = 0; c < 3; c++) d[3 * k + c] = row[from + c] * scale;
      for (long c = 0; c < 3L * n; c++) u[k * length + c] = row[from + 3 + c] * scale;
      for (long c = 3L * n; c < length; c++) u[k * length + c] = 0;
    }
    bad += !invert(d, b->inverse + 9L * i);
  }
  if (b->far_start)
    for (long k = 0; k < 9L * b->far_start[b->rows]; k++) b->far[k] = far[k] * scale;
  return bad;
}

/* The largest number on the diagonal of the AIJ matrix, in size; infinite if one is, or none. */
double largest(const Blocks *b, const double *values) {
  double most = 0;
  for (int i = 0; i < b->rows; i++) {
    const long length = 3L * (b->aij[i + 1] - b->aij[i]);
    const double *at = values + 9L * b->aij[i] + 3L * b->middle[i];
    for (int k = 0; k < 3; k++, at += length + 1) {
      if (!isfinite(*at)) return INFINITY;
      most = fmax(most, fabs(*at));
    }
  }
  return most;
}

static inline void times(const float *m, const float *x, float *y) {
  const float p = x[0], q = x[1], r = x[2];
  for (int k = 0; k < 3; k++) y[k] = m[3 * k] * p + m[3 * k + 1] * q + m[3 * k + 2] * r;
}

/* w -= L y, y = (D + L)^-1 w: the solution replaces w. */
void solve_lower(const Blocks *b, float *w) {
  float moved[3 * WIDEST + 8];
  for (int i = 0; i < b->rows; i++) {
    const int first = b->start[i], n = b->start[i + 1] - first;
    const long length = padded(n);
    const float *u = b->upper + b->place[i];
    float y[3];
    times(b->inverse + 9L * i, w + 3L * i, y);
    memcpy(w + 3L * i, y, sizeof y);
    for (long c = 0; c < length; c += 8)
      *(f8 *)(moved + c) = *(const f8 *)(u + c) * y[0] + *(const f8 *)(u + length + c) * y[1] +
                           *(const f8 *)(u + 2 * length + c) * y[2];
    for (int k = 0; k < n; k++) {
      float *to = w + 3L * b->column[first + k];
      for (int c = 0; c < 3; c++) to[c] -= moved[3 * k + c];
    }
  }
}

static inline float sum(f8 v) {
  return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]));
}

/* p = z + beta p, t = (D + U)^-1 p, w = U t. */
void sweep_up(const Blocks *b, float beta, const float *z, float *p, float *t, float *w) {
  float x[3 * WIDEST + 8];
  for (int i = b->rows - 1; i >= 0; i--) {
    const int first = b->start[i], n = b->start[i + 1] - first;
    const long length = padded(n);
    const float *u = b->upper + b->place[i];
    for (int k = 0; k < n; k++) memcpy(x + 3 * k, t + 3L * b->column[first + k], 3 * sizeof *x);
    for (long c = 3L * n; c < length; c++) x[c] = 0;
    f8 s0 = {0}, s1 = {0}, s2 = {0};
    for (long c = 0; c < length; c += 8) {
      const f8 at = *(const f8 *)(x + c);
      s0 += *(const f8 *)(u + c) * at;
      s1 += *(const f8 *)(u + length + c) * at;
      s2 += *(const f8 *)(u + 2 * length + c) * at;
    }
    const float s[3] = {sum(s0), sum(s1), sum(s2)};
    float v[3];
    for (int c = 0; c < 3; c++) {
      const long at = 3L * i + c;
      p[at] = z[at] + beta * p[at];
      v[c] = p[at] - s[c];
      w[at] = s[c];
    }
    times(b->inverse + 9L * i, v, t + 3L * i);
  }
}

/* q = t + (D + L)^-1 (w + columns of other ranks times their t); p.q. w is lost. */
double sweep_down(const Blocks *b, const float *p, const float *t, const float *ghosts, float *w,
                  float *q) {
  if (b->far_start)
    for (int i = 0; i < b->rows; i++) {
      const int first = b->far_start[i], n = b->far_start[i + 1] - first;
      const float *row = b->far + 9L * first;
      for (int r = 0; r < 3 && n; r++, row += 3L * n) {
        float s = 0;
        for (int k = 0; k < n; k++)
          for (int c = 0; c < 3; c++) s += row[3 * k + c] * ghosts[3L * b->far_column[first + k] + c];
        w[3L * i + r] += s;
      }
    }
  solve_lower(b, w);
  double dot = 0;
  for (long k = 0; k < 3L * b->rows; k++) {
    q[k] = t[k] + w[k];
    dot += (double)p[k] * q[k];
  }
  return dot;
}

/* x += alpha t, r -= alpha q, z = D r; r.z. */
double update(const Blocks *b, float alpha, const float *t, const float *q, float *x, float *r,
              float *z) {
  double dot = 0;
  for (long i = 0; i < 3L * b->rows; i += 3) {
    for (int c = 0; c < 3; c++) {
      x[i + c] += alpha * t[i + c];
      r[i + c] -= alpha * q[i + c];
    }
    times(b->diagonal + 3 * i, r + i, z + i);
    for (int c = 0; c < 3; c++) dot += (double)r[i + c] * z[i + c];
  }
  return dot;
}
