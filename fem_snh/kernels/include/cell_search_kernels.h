/* The search for cells: see cell_search_api.h. Its user defines the constants in capitals. */
#include <float.h>
#include <stdlib.h>

/* A grid of equal boxes over points. */
typedef struct {
  double low[3], edge;
  long size[3];
} Bins;

/* The bin of a coordinate, in range; NaN is in the first one. */
static inline long bin(const Bins *g, int axis, double x) {
  const double at = (x - g->low[axis]) / g->edge;
  return at >= g->size[axis] ? g->size[axis] - 1 : at > 0 ? (long)at : 0;
}

long points_in_boxes(int d, long n, const double *p, long m, const double *low, const double *high, long room, int *point,
                     int *box) {
  if (n == 0 || m == 0) return 0;
  Bins g = {{0, 0, 0}, 0, {1, 1, 1}};
  double top[3] = {0, 0, 0}, extent = 0;
  for (long i = 0; i < m; ++i)
    for (int k = 0; k < d; ++k) extent += (high[d * i + k] - low[d * i + k]) / ((double)m * d);
  for (int k = 0; k < d; ++k) {
    g.low[k] = INFINITY, top[k] = -INFINITY;
    for (long i = 0; i < n; ++i) g.low[k] = fmin(g.low[k], p[d * i + k]), top[k] = fmax(top[k], p[d * i + k]);
    if (!(top[k] >= g.low[k] && top[k] - g.low[k] < INFINITY)) g.low[k] = top[k] = 0; /* not finite */
  }
  g.edge = fmax(extent, DBL_MIN); /* bins as large as boxes, but not many more than points */
  for (long total = 0;; g.edge *= 2) {
    double bins = 1;
    for (int k = 0; k < d; ++k) bins *= floor((top[k] - g.low[k]) / g.edge) + 1;
    if (!(bins <= 8.0 * n + 64)) continue;
    total = 1;
    for (int k = 0; k < d; ++k) total *= g.size[k] = (long)((top[k] - g.low[k]) / g.edge) + 1;
    break;
  }
  const long bins = g.size[0] * g.size[1] * g.size[2];
  int *start = calloc(bins + 1, sizeof *start), *order = malloc(n * sizeof *order), *where = malloc(n * sizeof *where);
  for (long i = 0; i < n; ++i) {
    long at = 0;
    for (int k = 0; k < d; ++k) at = at * g.size[k] + bin(&g, k, p[d * i + k]);
    where[i] = at;
    ++start[at + 1];
  }
  for (long b = 0; b < bins; ++b) start[b + 1] += start[b];
  for (long i = n - 1; i >= 0; --i) order[--start[where[i] + 1]] = i; /* start[b + 1] is now the start of b */
  long count = 0;
  for (long i = 0; i < m; ++i) {
    const double *from = low + d * i, *to = high + d * i;
    long first[3] = {0, 0, 0}, last[3] = {0, 0, 0};
    for (int k = 0; k < d; ++k) first[k] = bin(&g, k, from[k]), last[k] = bin(&g, k, to[k]);
    for (long a = first[0]; a <= last[0]; ++a)
      for (long b = first[1]; b <= last[1]; ++b)
        for (long c = first[2]; c <= last[2]; ++c) {
          const long at = (a * g.size[1] + b) * g.size[2] + c;
          const long end = at + 1 < bins ? start[at + 2] : n;
          for (long j = start[at + 1]; j < end; ++j) {
            const double *q = p + (long)d * order[j];
            int inside = 1;
            for (int k = 0; k < d; ++k) inside &= q[k] >= from[k] && q[k] <= to[k];
            if (!inside) continue;
            if (count < room) point[count] = order[j], box[count] = i;
            ++count;
          }
        }
  }
  free(start), free(order), free(where);
  return count;
}

/* Largest number of nodes of a cell: a hexahedron of degree 3. */
#define MOST_NODES 64

/* The coefficients [k][d] of the monomials of a cell with nodes y [k][d]. */
static void monomials_of(const CellMap *map, const double *y, double *a) {
  for (int m = 0; m < map->k; ++m)
    for (int i = 0; i < map->d; ++i) {
      a[map->d * m + i] = 0;
      for (int b = 0; b < map->k; ++b) a[map->d * m + i] += map->coefficient[map->k * m + b] * y[map->d * b + i];
    }
}

/* x and dx_i/dxi_j [d][d] at xi, from coefficients. */
static void evaluate_map(const CellMap *map, const double *a, const double *xi, double *x, double *J) {
  const int d = map->d;
  double powers[3][4]; /* degree 3 at most */
  for (int i = 0; i < d; ++i) {
    powers[i][0] = 1;
    for (int e = 1; e < 4; ++e) powers[i][e] = powers[i][e - 1] * (2 * xi[i] - 1);
  }
  memset(x, 0, d * sizeof *x);
  memset(J, 0, d * d * sizeof *J);
  for (int m = 0; m < map->k; ++m) {
    const int *e = map->power + d * m;
    double value = 1;
    for (int i = 0; i < d; ++i) value *= powers[i][e[i]];
    for (int i = 0; i < d; ++i) x[i] += value * a[d * m + i];
    for (int j = 0; j < d; ++j) {
      if (e[j] == 0) continue;
      double slope = 2 * e[j] * powers[j][e[j] - 1]; /* ds/dxi = 2 */
      for (int i = 0; i < d; ++i)
        if (i != j) slope *= powers[i][e[i]];
      for (int i = 0; i < d; ++i) J[d * i + j] += slope * a[d * m + i];
    }
  }
}

static double determinant(int d, const double *J) {
  if (d == 2) return J[0] * J[3] - J[1] * J[2];
  return J[0] * (J[4] * J[8] - J[5] * J[7]) - J[1] * (J[3] * J[8] - J[5] * J[6]) + J[2] * (J[3] * J[7] - J[4] * J[6]);
}

void map_points(const CellMap *map, long n, const double *y, const double *xi, double *x, double *det) {
  const int d = map->d;
  for (long i = 0; i < n; ++i) {
    double a[3 * MOST_NODES], J[9];
    monomials_of(map, y + (long)map->k * d * i, a);
    evaluate_map(map, a, xi + d * i, x + d * i, J);
    det[i] = determinant(d, J);
  }
}

void invert_map(const CellMap *map, long n, const double *y, const double *x, const double *center, double *xi,
                double *outside, unsigned char *found) {
  const int d = map->d;
  for (long i = 0; i < n; ++i, y += (long)map->k * d, x += d, xi += d) {
    double a[3 * MOST_NODES], size = 0, lowest = INFINITY, upper = map->simplex ? 0 : -INFINITY;
    monomials_of(map, y, a);
    for (int k = 0; k < d; ++k) {
      double low = INFINITY, high = -INFINITY;
      for (int b = 0; b < map->k; ++b) low = fmin(low, y[d * b + k]), high = fmax(high, y[d * b + k]);
      size = fmax(size, high - low);
      xi[k] = center[k];
    }
    const double flat = DBL_EPSILON * (d == 2 ? size * size : size * size * size);
    found[i] = 0;
    for (int iteration = 0; iteration < ITERATIONS; ++iteration) {
      double at[3], rest[3], J[9];
      evaluate_map(map, a, xi, at, J);
      double square = 0;
      for (int k = 0; k < d; ++k) rest[k] = x[k] - at[k], square += rest[k] * rest[k];
      const double det = determinant(d, J);
      const int done = sqrt(square) <= RESIDUAL * size;
      found[i] |= done;
      if (!(fabs(det) > flat)) break;
      for (int k = 0; k < d; ++k) { /* Cramer's rule */
        double replaced[9];
        memcpy(replaced, J, sizeof J);
        for (int j = 0; j < d; ++j) replaced[d * j + k] = rest[j];
        xi[k] = fmin(fmax(xi[k] + determinant(d, replaced) / det, center[k] - RANGE), center[k] + RANGE);
      }
      if (done) break;
    }
    for (int k = 0; k < d; ++k) {
      lowest = fmin(lowest, xi[k]);
      upper = map->simplex ? upper + xi[k] : fmax(upper, xi[k]);
    }
    outside[i] = fmax(-lowest, upper - 1);
  }
}
