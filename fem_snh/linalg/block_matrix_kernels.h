/* The functions of block_matrix_api.h: two sweeps and a vector update make an iteration of conjugate gradients
 * with SSOR in the form of Eisenstat 1981, in which the product with A costs nothing beside the
 * preconditioner's two triangular solves. MAX_ROW_BLOCKS is defined by linalg/library.py. */
typedef float f8 __attribute__((vector_size(32), aligned(4)));
typedef float f4 __attribute__((vector_size(16), aligned(4)));

/* Floats in a row of n blocks, padded to a multiple of 8. */
static inline long padded(int blocks) { return (3L * blocks + 7) / 8 * 8; }

/* b = a^-1 of a symmetric 3x3 matrix. Returns 0 if it is not positive definite to single precision. A nearly
 * singular one, such as that of a node without stiffness in a clamped Hessian, is shifted by e, the size of
 * its rounding errors (1e-6 of its trace; 1e-12 of the matrix's largest entry, which is scaled to 1). */
static inline int invert_block(float *a, float *b) {
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

long matrix_fill(const SymmetricBlockMatrix *b, const double *values, const double *off_diagonal, double scale) {
  long bad = 0;
  for (int i = 0; i < b->rows; i++) {
    const int n = b->upper_start[i + 1] - b->upper_start[i];
    const double *row = values + b->aij_offset[i];
    float *u = b->upper + b->upper_offset[i], *d = b->diagonal + 9L * i;
    const long length = padded(n), from = 3L * b->aij_diagonal[i];
    for (int k = 0; k < 3; k++, row += b->aij_stride[i]) {
      for (int c = 0; c < 3; c++) d[3 * k + c] = row[from + c] * scale;
      for (long c = 0; c < 3L * n; c++) u[k * length + c] = row[from + 3 + c] * scale;
      for (long c = 3L * n; c < length; c++) u[k * length + c] = 0;
    }
    bad += !invert_block(d, b->diagonal_inverse + 9L * i);
  }
  for (int i = 0; b->off_diagonal_start && i < b->rows; i++) {
    const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
    for (int k = 0; k < n; k++)
      for (int r = 0; r < 3; r++) {
        const double *from = off_diagonal + b->off_diagonal_value[first + k] + r * (long)b->off_diagonal_stride[i];
        float *to = b->off_diagonal + 9L * first + 3L * (r * n + k);
        for (int c = 0; c < 3; c++) to[c] = from[c] * scale;
      }
  }
  return bad;
}

double matrix_largest_diagonal(const SymmetricBlockMatrix *b, const double *values) {
  double most = 0;
  for (int i = 0; i < b->rows; i++) {
    const double *at = values + b->aij_offset[i] + 3L * b->aij_diagonal[i];
    for (int k = 0; k < 3; k++, at += b->aij_stride[i] + 1L) {
      if (!isfinite(*at)) return INFINITY;
      most = fmax(most, fabs(*at));
    }
  }
  return most;
}

/* y = m x for a 3x3 block. */
static inline void multiply_block(const float *m, const float *x, float *y) {
  const float p = x[0], q = x[1], r = x[2];
  for (int k = 0; k < 3; k++) y[k] = m[3 * k] * p + m[3 * k + 1] * q + m[3 * k + 2] * r;
}

/* Forward substitution: row i of the solution y is final when it is reached, and L_ki y_i is subtracted from
 * the rows k > i; L_ki is the transpose of the stored U_ik. */
void matrix_solve_lower(const SymmetricBlockMatrix *b, float *w) {
  float product[3 * MAX_ROW_BLOCKS + 8];
  for (int i = 0; i < b->rows; i++) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = padded(n);
    const float *u = b->upper + b->upper_offset[i];
    float y[3];
    multiply_block(b->diagonal_inverse + 9L * i, w + 3L * i, y);
    memcpy(w + 3L * i, y, sizeof y);
    for (long c = 0; c < length; c += 8)
      *(f8 *)(product + c) = *(const f8 *)(u + c) * y[0] + *(const f8 *)(u + length + c) * y[1] +
                           *(const f8 *)(u + 2 * length + c) * y[2];
    for (int k = 0; k < n; k++) {
      float *to = w + 3L * b->upper_column[first + k];
      for (int c = 0; c < 3; c++) to[c] -= product[3 * k + c];
    }
  }
}

/* A copy of t has four lanes for each node, so that one load reads what one store has just written. The nodes that
 * were computed last enter a row's sums last: the processor computes the others before its predecessor is known.
 * The fourth lane of a sum is of no use, and is left out. */
void matrix_backward_sweep(const SymmetricBlockMatrix *b, float beta, const float *z, float *p, float *t, float *w) {
  for (int i = b->rows - 1; i >= 0; i--) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = padded(n);
    const float *u = b->upper + b->upper_offset[i];
    const int *column = b->upper_column + first;
    f4 s[2][3] = {0};
    for (int k = n - 1; k >= 0; k--) {
      const f4 at = *(const f4 *)(b->padded_t + 4L * column[k]);
      f4 *sum = s[k & 1];
      for (int r = 0; r < 3; r++) sum[r] += *(const f4 *)(u + r * length + 3L * k) * at;
    }
    float v[3];
    for (int c = 0; c < 3; c++) {
      const long at = 3L * i + c;
      const f4 both = s[0][c] + s[1][c];
      w[at] = (both[0] + both[1]) + both[2];
      p[at] = z[at] + beta * p[at];
      v[c] = p[at] - w[at];
    }
    multiply_block(b->diagonal_inverse + 9L * i, v, t + 3L * i);
    *(f4 *)(b->padded_t + 4L * i) = (f4){t[3L * i], t[3L * i + 1], t[3L * i + 2], 0};
  }
}

double matrix_forward_sweep(const SymmetricBlockMatrix *b, const float *p, const float *t, const float *ghosts, float *w, float *q) {
  if (b->off_diagonal_start)
    for (int i = 0; i < b->rows; i++) {
      const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
      const float *row = b->off_diagonal + 9L * first;
      for (int r = 0; r < 3 && n; r++, row += 3L * n) {
        float s = 0;
        for (int k = 0; k < n; k++)
          for (int c = 0; c < 3; c++) s += row[3 * k + c] * ghosts[3L * b->off_diagonal_column[first + k] + c];
        w[3L * i + r] += s;
      }
    }
  matrix_solve_lower(b, w);
  double dot = 0;
  for (long k = 0; k < 3L * b->rows; k++) {
    q[k] = t[k] + w[k];
    dot += (double)p[k] * q[k];
  }
  return dot;
}

double matrix_cg_update(const SymmetricBlockMatrix *b, float alpha, const float *t, const float *q, float *x, float *r, float *z) {
  double dot = 0;
  for (long i = 0; i < 3L * b->rows; i += 3) {
    for (int c = 0; c < 3; c++) {
      x[i + c] += alpha * t[i + c];
      r[i + c] -= alpha * q[i + c];
    }
    multiply_block(b->diagonal + 3 * i, r + i, z + i);
    for (int c = 0; c < 3; c++) dot += (double)r[i + c] * z[i + c];
  }
  return dot;
}
