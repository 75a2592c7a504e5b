/* Contact at quadrature points: see contact_api.h. */

static inline int facet(const int *which, int i) { return which ? which[i] : i; }

double largest_move(long n, const int *node, const double *X, const double *u, const double *R, const double *c,
                    const double *before) {
  double largest = 0;
  for (long a = 0; a < n; ++a) {
    double x[3], square = 0;
    for (int k = 0; k < 3; ++k) x[k] = X[3 * a + k] + u[3 * (long)node[a] + k] - c[k];
    for (int k = 0; k < 3; ++k) {
      const double way = x[0] * R[k] + x[1] * R[3 + k] + x[2] * R[6 + k] - before[3 * a + k];
      square += way * way;
    }
    if (!(square <= largest)) largest = square; /* NaN, too */
  }
  return largest;
}

int same_values(long n, const double *a, const double *b) { return memcmp(a, b, n * sizeof *a) == 0; }

void facet_vectors(const Facets *f, int m, const int *which, const double *u, int deformed, double *y) {
  for (int i = 0; i < m; ++i) {
    const long at = facet(which, i);
    const int *node = f->node + f->nodes * at;
    for (int q = 0; q < f->points; ++q, y += 3) {
      const double *X = f->X + 3 * (f->points * at + q);
      double s[3] = {0, 0, 0};
      for (int a = 0; a < f->nodes; ++a)
        for (int k = 0; k < 3; ++k) s[k] += f->basis[f->nodes * q + a] * u[3 * (long)node[a] + k];
      for (int k = 0; k < 3; ++k) y[k] = deformed ? X[k] + s[k] : s[k];
    }
  }
}

void add_facet_vectors(const Facets *f, int m, const int *which, const double *v, int size, int components, double *out) {
  for (int i = 0; i < m; ++i) {
    const int *node = f->node + f->nodes * (long)facet(which, i);
    for (int q = 0; q < f->points; ++q, v += size)
      for (int a = 0; a < f->nodes; ++a)
        for (int k = 0; k < components; ++k) out[components * (long)node[a] + k] += f->basis[f->nodes * q + a] * v[k];
  }
}

/* Below the first ratio of depth to gap a series is more accurate than the closed form; the second is the largest. */
#define SHALLOW 1e-2
#define DEEP 1e12

static void mean_response(double k, double g0, double g, double *energy, double *pressure, double *stiffness) {
  const double p0 = fmax(-k * g0, 0), p1 = fmax(-k * g, 0), change = g - g0;
  if (p0 > 0 && p1 > 0) { /* in contact at both */
    *energy = p1 * p1 / (4 * k) + p0 * (p0 / k - change) / 2;
    *pressure = (p0 + p1) / 2;
    *stiffness = k / 2;
  } else if (p0 > 0) { /* contact ends: the change of the gap over the depth before */
    const double ratio = k * change / p0;
    *energy = -p0 * p0 / (2 * k) * log(ratio);
    *pressure = p0 / (2 * ratio);
    *stiffness = k / (2 * ratio * ratio);
  } else { /* contact begins, or there is none: the depth over the gap before */
    const double depth = p1 / k, r = p1 > 0 ? depth / fmax(g0, depth / DEEP) : 0;
    const double series = r / 3 - r * r / 4 + r * r * r / 5 - r * r * r * r / 6 + r * r * r * r * r / 7;
    const double begun = r < SHALLOW ? series : 0.5 - 1 / r + log1p(r) / (r * r);
    *energy = k / 2 * depth * depth * begun;
    *pressure = p1 / 2 * r / (1 + r);
    *stiffness = k / 2 * r * (r + 2) / ((1 + r) * (1 + r));
  }
}

void contact_response(int n, int size, const int *row, const double *k, const double *l, const double *g0, const double *g,
                      double *energy, double *pressure, double *stiffness) {
  for (long i = 0, at = 0; i < n; ++i)
    for (int q = 0; q < size; ++q, ++at) {
      const long all = (long)size * (row ? row[i] : i) + q;
      if (g0) {
        mean_response(k[all], g0[at], g[at], energy + at, pressure + at, stiffness + at);
        continue;
      }
      const double p = fmax(l[all] - k[all] * g[at], 0);
      energy[at] = p * p / (2 * k[all]);
      pressure[at] = p;
      stiffness[at] = k[all];
    }
}

void contact_forces(const Facets *f, int m, const int *which, const NormalContact *c, double *force) {
  for (int i = 0, at = 0; i < m; ++i)
    for (int q = 0; q < f->points; ++q, ++at)
      for (int k = 0; k < 3; ++k)
        force[3 * at + k] = f->weight[f->points * (long)facet(which, i) + q] * c->pressure[at] * c->normal[3 * at + k];
}

double friction_stresses(const Facets *f, int m, const int *which, const Friction *c, const double *u, double *slip,
                         double *stress) {
  double energy = 0;
  facet_vectors(f, m, which, u, 0, slip);
  for (int i = 0, at = 0; i < m; ++i) {
    const double k = c->stiffness[facet(which, i)];
    for (int q = 0; q < f->points; ++q, ++at) {
      const double *n = c->normal + 3 * (f->points * (long)facet(which, i) + q);
      double *s = slip + 3 * at, along = 0, square = 0;
      for (int j = 0; j < 3; ++j) along += (s[j] += c->offset[3 * at + j]) * n[j];
      for (int j = 0; j < 3; ++j) s[j] -= along * n[j];
      for (int j = 0; j < 3; ++j) square += s[j] * s[j];
      const double length = sqrt(square), factor = k * length <= c->limit[at] ? k : c->limit[at] / length;
      for (int j = 0; j < 3; ++j) stress[3 * at + j] = factor * s[j];
      energy += f->weight[f->points * (long)facet(which, i) + q] * (factor - factor * factor / (2 * k)) * square;
    }
  }
  return energy;
}

/* Add sum_q N_a M_q N_b, M [points][9], to the matrix K of the cell of a facet. */
static void add_to_cell(const Facets *f, long at, const double *M, double *K) {
  const int *cell_node = f->cell_node + f->nodes * at, c = f->components, n = c * f->cell_nodes;
  for (int a = 0; a < f->nodes; ++a)
    for (int b = 0; b < f->nodes; ++b) {
      double *block = K + (long)n * c * cell_node[a] + c * cell_node[b];
      for (int q = 0; q < f->points; ++q) {
        const double product = f->basis[f->nodes * q + a] * f->basis[f->nodes * q + b];
        for (int i = 0; i < c; ++i)
          for (int j = 0; j < c; ++j) block[(long)n * i + j] += product * M[9 * q + 3 * i + j];
      }
    }
}

/* Relative rounding error of an eigenvalue. */
#define ROUNDING 1e-12

/* Filter the symmetric A [9]; return whether it had a negative eigenvalue. */
static int filter_symmetric(int filter, double *A) {
  const real packed[6] = {splat(A[0]), splat(A[4]), splat(A[8]), splat(A[1]), splat(A[2]), splat(A[5])};
  real e[3], Q[9];
  eigen3(JACOBI, packed, e, Q);
  memset(A, 0, 9 * sizeof *A);
  for (int k = 0; k < 3; ++k) {
    const double value = filter == CLAMP ? fmax(e[k][0], 0) : fabs(e[k][0]);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) A[3 * i + j] += value * Q[3 * k + i][0] * Q[3 * k + j][0];
  }
  return e[2][0] < -ROUNDING * fmax(e[0][0], -e[2][0]);
}

int contact_matrices(const Facets *f, int m, const int *which, const NormalContact *c, int filter, double factor,
                     int *acting, double *K, int *filtered) {
  const long size = (long)f->components * f->cell_nodes * f->components * f->cell_nodes;
  int count = 0;
  double M[9 * f->points];
  for (int i = 0; i < m; ++i) {
    const long at = facet(which, i);
    int touches = 0;
    memset(M, 0, sizeof M);
    for (int q = 0; q < f->points; ++q) {
      const long row = (long)f->points * i + q;
      const double p = c->pressure[row], *n = c->normal + 3 * row, *curvature = c->curvature + 9 * row;
      if (p == 0) continue;
      double *A = M + 9 * q, largest = 0;
      touches = 1;
      for (int k = 0; k < 9; ++k) largest = fmax(largest, fabs(A[k] = -p * curvature[k]));
      if (largest > 0 && filter != EXACT) *filtered += filter_symmetric(filter, A);
      for (int k = 0; k < 9; ++k) {
        A[k] += c->stiffness[row] * n[k / 3] * n[k % 3];
        A[k] *= factor * f->weight[f->points * at + q];
      }
    }
    if (!touches) continue;
    memset(K + size * count, 0, size * sizeof *K);
    add_to_cell(f, at, M, K + size * count);
    acting[count++] = i;
  }
  return count;
}

void friction_matrices(const Facets *f, int m, const int *which, const Friction *c, const double *slip, double *K) {
  const long size = (long)f->components * f->cell_nodes * f->components * f->cell_nodes;
  double M[9 * f->points];
  memset(K, 0, m * size * sizeof *K);
  for (int i = 0; i < m; ++i) {
    const long at = facet(which, i);
    const double k = c->stiffness[at];
    for (int q = 0; q < f->points; ++q) {
      const long row = (long)f->points * i + q;
      const double *s = slip + 3 * row, *n = c->normal + 3 * (f->points * at + q);
      const double length = sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]), limit = c->limit[row];
      const int sticks = k * length <= YIELD * limit;
      /* Where nothing is lagged the limit is zero, and a point at rest would seem to stick. */
      const double scale = limit > 0 ? f->weight[f->points * at + q] * (sticks ? k : limit / length) : 0;
      for (int a = 0; a < 9; ++a) {
        const double along = sticks ? 0 : s[a / 3] * s[a % 3] / (length * length);
        M[9 * q + a] = scale * ((a % 4 == 0) - n[a / 3] * n[a % 3] - along);
      }
    }
    add_to_cell(f, at, M, K + size * i);
  }
}
