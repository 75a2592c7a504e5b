/* Element matrices of a bilinear form from FFCx's kernels, and a test for definiteness: see form_cells_api.h. */

typedef void tabulate_tensor(double *A, const double *w, const double *c, const double *x, const int *facet,
                             const unsigned char *permutation CUSTOM_DATA_TYPE);

double tabulate_entities(const FormCells *c, const FormIntegral *f, int start, int count, int symmetric, double *K) {
  tabulate_tensor *kernel = (tabulate_tensor *)f->kernel;
  const int n = c->components * c->nodes, corners = c->geometry_nodes;
  double x[3 * corners], asymmetry = 0;
  for (int k = 0; k < count; ++k, K += n * n) {
    const long entity = start + k;
    const int *at = f->entities + f->width * entity, facet = f->width == 2 ? at[1] : 0;
    const int *geometry = c->geometry + (long)corners * at[0];
    for (int a = 0; a < corners; ++a)
      for (int i = 0; i < 3; ++i) x[3 * a + i] = c->x[3 * (long)geometry[a] + i];
    memset(K, 0, sizeof(double) * n * n);
    kernel(K, f->coefficients + f->num_coefficients * entity, f->constants, x, &facet, 0 CUSTOM_DATA);
    double largest = 0, difference = 0;
    for (int i = 0; i < n; ++i) {
      largest = fmax(largest, fabs(K[n * i + i]));
      for (int j = 0; j < i; ++j) {
        const double a = K[n * i + j], b = K[n * j + i];
        largest = fmax(largest, fmax(fabs(a), fabs(b)));
        difference = fmax(difference, fabs(a - b));
        if (symmetric) K[n * i + j] = K[n * j + i] = 0.5 * (a + b);
      }
    }
    if (difference > asymmetry * largest) asymmetry = difference / largest;
  }
  return asymmetry;
}

/* Cholesky's factorisation A = U^T U of the upper triangle, in place; 0 if a pivot is not positive. */
static int cholesky(int n, double *A) {
  for (int j = 0; j < n; ++j) {
    double *pivot = A + n * j;
    if (!(pivot[j] > 0)) return 0;
    const double inverse = 1 / sqrt(pivot[j]);
    for (int k = j; k < n; ++k) pivot[k] *= inverse;
    for (int i = j + 1; i < n; ++i) {
      double *row = A + n * i;
      const double factor = pivot[i];
      for (int k = i; k < n; ++k) row[k] -= factor * pivot[k];
    }
  }
  return 1;
}

int find_indefinite(int n, int count, const double *K, double shift, double *work, int *indefinite) {
  int found = 0;
  for (int m = 0; m < count; ++m, K += n * n) {
    double largest = 0, sum = 0; /* the sum is NaN if an entry is NaN or infinite */
    for (int i = 0; i < n * n; ++i) {
      largest = fabs(K[i]) > largest ? fabs(K[i]) : largest;
      sum += 0 * K[i];
    }
    if (largest == 0 && sum == 0) continue;
    memcpy(work, K, sizeof(double) * n * n);
    for (int i = 0; i < n; ++i) work[n * i + i] += shift * largest;
    if (sum != 0 || !cholesky(n, work)) indefinite[found++] = m;
  }
  return found;
}
