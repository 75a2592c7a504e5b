/* The functions of block_matrix_api.h: two sweeps and a vector update make an iteration of conjugate gradients
 * with SSOR in the form of Eisenstat 1981, in which the product with A costs nothing beside the
 * preconditioner's two triangular solves. */

/* Part of the absolute row sums of the other ranks' columns that is added to D. With 1 M bounds A, as the smoothers of
 * Baker et al. 2011; iterations are fewest from 0.25 to 0.5 (docs/results/scaling.md). */
#define OFF_DIAGONAL_WEIGHT 0.35f

typedef float f4 __attribute__((vector_size(16), aligned(4)));

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
    float *u = b->upper + 9L * b->upper_start[i], *d = b->diagonal + 9L * i;
    const long length = 3L * n, from = 3L * b->aij_diagonal[i];
    for (int k = 0; k < 3; k++, row += b->aij_stride[i]) {
      for (int c = 0; c < 3; c++) d[3 * k + c] = row[from + c] * scale;
      for (long c = 0; c < length; c++) u[k * length + c] = row[from + 3 + c] * scale;
    }
  }
  for (int i = 0; b->off_diagonal_start && i < b->rows; i++) {
    const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
    float *shift = b->shift + 3L * i;
    for (int r = 0; r < 3; r++) shift[r] = 0;
    for (int k = 0; k < n; k++)
      for (int r = 0; r < 3; r++) {
        const double *from = off_diagonal + b->off_diagonal_value[first + k] + r * (long)b->off_diagonal_stride[i];
        float *to = b->off_diagonal + 9L * first + 3L * (r * n + k);
        for (int c = 0; c < 3; c++) {
          to[c] = from[c] * scale;
          shift[r] += OFF_DIAGONAL_WEIGHT * fabsf(to[c]);
        }
      }
    for (int r = 0; r < 3; r++) b->diagonal[9L * i + 4 * r] += shift[r];
  }
  for (long i = 0; i < b->rows; i++) bad += !invert_block(b->diagonal + 9 * i, b->diagonal_inverse + 9 * i);
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

/* The sweeps work on vectors of four lanes a node, so that one load reads what one store has just written. The
 * fourth lane of a product is that of the next block, and is never used. */
static inline f4 load3(const float *x) { return (f4){x[0], x[1], x[2], 0}; }
static inline void store3(float *to, f4 x) { for (int c = 0; c < 3; c++) to[c] = x[c]; }
static inline f4 load4(const float *x) { return *(const f4 *)x; }

/* m x for a 3x3 block. */
static inline f4 multiply_block(const float *m, f4 x) {
  f4 y = {0};
  for (int k = 0; k < 3; k++) y[k] = m[3 * k] * x[0] + m[3 * k + 1] * x[1] + m[3 * k + 2] * x[2];
  return y;
}

/* Forward substitution of one or two right-hand sides in `lanes`, those of a node side by side: row i of a solution
 * y is final when it is reached, and L_ki y_i is subtracted from the rows k > i; L_ki is the transpose of the
 * stored U_ik. */
static inline __attribute__((always_inline)) void solve_lower_lanes(const SymmetricBlockMatrix *b, const int sides) {
  for (int i = 0; i < b->rows; i++) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = 3L * n;
    const float *u = b->upper + 9L * b->upper_start[i];
    f4 y[2];
    for (int s = 0; s < sides; s++) {
      float *at = b->lanes + 4L * (sides * i + s);
      *(f4 *)at = y[s] = multiply_block(b->diagonal_inverse + 9L * i, load4(at));
    }
    for (int k = 0; k < n; k++, u += 3) {
      const f4 u0 = load4(u), u1 = load4(u + length), u2 = load4(u + 2 * length);
      float *at = b->lanes + 4L * sides * b->upper_column[first + k];
      for (int s = 0; s < sides; s++) {
        const f4 product = u0 * y[s][0] + u1 * y[s][1] + u2 * y[s][2];
        *(f4 *)(at + 4 * s) -= product;
      }
    }
  }
}

void matrix_solve_lower(const SymmetricBlockMatrix *b, float *w) {
  for (long i = 0; i < b->rows; i++) *(f4 *)(b->lanes + 4 * i) = load3(w + 3 * i);
  solve_lower_lanes(b, 1);
  for (long i = 0; i < b->rows; i++) store3(w + 3 * i, load4(b->lanes + 4 * i));
}

double matrix_solve_lower_both(const SymmetricBlockMatrix *b, float *w, const float *other) {
  for (long i = 0; i < b->rows; i++) {
    *(f4 *)(b->lanes + 8 * i) = load3(w + 3 * i);
    *(f4 *)(b->lanes + 8 * i + 4) = load3(other + 3 * i);
  }
  solve_lower_lanes(b, 2);
  double norm_squared = 0;
  for (long i = 0; i < b->rows; i++) {
    store3(w + 3 * i, load4(b->lanes + 8 * i));
    const f4 y = load4(b->lanes + 8 * i + 4), z = multiply_block(b->diagonal + 9 * i, y);
    for (int c = 0; c < 3; c++) norm_squared += (double)y[c] * z[c];
  }
  return norm_squared;
}

void matrix_multiply_lower(const SymmetricBlockMatrix *b, const float *w, double factor, double *y) {
  memset(b->lanes, 0, 16L * b->rows);
  for (long i = 0; i < b->rows; i++) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = 3L * n;
    const float *u = b->upper + 9L * first;
    const f4 x = load3(w + 3 * i), sum = load4(b->lanes + 4 * i) + multiply_block(b->diagonal + 9 * i, x);
    for (int c = 0; c < 3; c++) y[3 * i + c] = factor * sum[c];
    for (int k = 0; k < n; k++, u += 3) {
      float *at = b->lanes + 4L * b->upper_column[first + k];
      *(f4 *)at += load4(u) * x[0] + load4(u + length) * x[1] + load4(u + 2 * length) * x[2];
    }
  }
}

/* The nodes that were computed last enter a row's sums last: the processor computes the others before its
 * predecessor is known. Two sums for each component halve the chain of additions. */
void matrix_backward_sweep(const SymmetricBlockMatrix *b, float beta, const float *z, float *p, float *t, float *w) {
  for (long i = b->rows - 1; i >= 0; i--) {
    const int first = b->upper_start[i], n = b->upper_start[i + 1] - first;
    const long length = 3L * n;
    const float *u = b->upper + 9L * b->upper_start[i];
    f4 x0 = {0}, y0 = {0}, z0 = {0}, x1 = {0}, y1 = {0}, z1 = {0};
    int k = n - 1;
    for (; k > 0; k -= 2) {
      const int *column = b->upper_column + first + k;
      const f4 t0 = load4(b->lanes + 4L * column[0]), t1 = load4(b->lanes + 4L * column[-1]);
      const float *u0 = u + 3L * k, *u1 = u0 - 3;
      x0 += load4(u0) * t0; y0 += load4(u0 + length) * t0; z0 += load4(u0 + 2 * length) * t0;
      x1 += load4(u1) * t1; y1 += load4(u1 + length) * t1; z1 += load4(u1 + 2 * length) * t1;
    }
    if (k == 0) {
      const f4 t1 = load4(b->lanes + 4L * b->upper_column[first]);
      x1 += load4(u) * t1; y1 += load4(u + length) * t1; z1 += load4(u + 2 * length) * t1;
    }
    x0 += x1; y0 += y1; z0 += z1;
    const f4 s = {(x0[0] + x0[1]) + x0[2], (y0[0] + y0[1]) + y0[2], (z0[0] + z0[1]) + z0[2], 0};
    const f4 direction = load3(z + 3 * i) + beta * load3(p + 3 * i);
    const f4 solution = multiply_block(b->diagonal_inverse + 9 * i, direction - s);
    *(f4 *)(b->lanes + 4 * i) = solution;
    store3(p + 3 * i, direction); store3(w + 3 * i, s); store3(t + 3 * i, solution);
  }
}

double matrix_forward_sweep(const SymmetricBlockMatrix *b, const float *p, const float *t, const float *ghosts, const float *w, float *q) {
  for (long i = 0; i < b->rows; i++) {
    f4 s = load3(w + 3 * i);
    if (b->off_diagonal_start) {
      for (int r = 0; r < 3; r++) s[r] -= b->shift[3L * i + r] * t[3L * i + r];
      const int first = b->off_diagonal_start[i], n = b->off_diagonal_start[i + 1] - first;
      const float *row = b->off_diagonal + 9L * first;
      for (int r = 0; r < 3 && n; r++, row += 3L * n)
        for (int k = 0; k < n; k++)
          for (int c = 0; c < 3; c++) s[r] += row[3 * k + c] * ghosts[3L * b->off_diagonal_column[first + k] + c];
    }
    *(f4 *)(b->lanes + 4 * i) = s;
  }
  solve_lower_lanes(b, 1);
  double dot = 0;
  for (long i = 0; i < b->rows; i++)
    for (int c = 0; c < 3; c++) {
      const float value = t[3 * i + c] + b->lanes[4 * i + c];
      q[3 * i + c] = value;
      dot += (double)p[3 * i + c] * value;
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
    store3(z + i, multiply_block(b->diagonal + 3 * i, load3(r + i)));
    for (int c = 0; c < 3; c++) dot += (double)r[i + c] * z[i + c];
  }
  return dot;
}
