/* Searches on a surface: see surface_search_api.h. Its users define the constants in capitals. */
#include <float.h>

static inline double product(int d, const double *a, const double *b) {
  double sum = 0;
  for (int i = 0; i < d; ++i) sum += a[i] * b[i];
  return sum;
}

/* Scale v to length 1; a zero vector stays zero. */
static inline void to_unit(int d, double *v) {
  const double length = fmax(sqrt(product(d, v, v)), DBL_MIN);
  for (int i = 0; i < d; ++i) v[i] /= length;
}

/* The closest point of a triangle T [c][d]: barycentric coordinates, p minus the point; returns the squared distance.
 * The inside first, then the edges (1, 2), (1, 3), (2, 3): a later one counts if it is closer. */
static double closest_point(int c, int d, const double *p, const double *T, double *coordinates, double *arm) {
  double best = INFINITY;
  if (c == 3) {
    double ab[3], ac[3], ap[3], other[3];
    for (int i = 0; i < d; ++i) ab[i] = T[d + i] - T[i], ac[i] = T[2 * d + i] - T[i], ap[i] = p[i] - T[i];
    const double d11 = product(d, ab, ab), d12 = product(d, ab, ac), d22 = product(d, ac, ac);
    const double e1 = product(d, ab, ap), e2 = product(d, ac, ap), det = fmax(d11 * d22 - d12 * d12, DBL_MIN);
    const double v = (d22 * e1 - d12 * e2) / det, w = (d11 * e2 - d12 * e1) / det;
    for (int i = 0; i < d; ++i) other[i] = ap[i] - v * ab[i] - w * ac[i];
    if (1 - v - w >= 0 && v >= 0 && w >= 0) {
      best = product(d, other, other);
      coordinates[0] = 1 - v - w, coordinates[1] = v, coordinates[2] = w;
      memcpy(arm, other, d * sizeof *arm);
    }
  }
  for (int i = 0; i < c; ++i)
    for (int j = i + 1; j < c; ++j) {
      double edge[3], from[3];
      for (int k = 0; k < d; ++k) edge[k] = T[d * j + k] - T[d * i + k], from[k] = p[k] - T[d * i + k];
      const double t = fmin(fmax(product(d, from, edge) / fmax(product(d, edge, edge), DBL_MIN), 0), 1);
      for (int k = 0; k < d; ++k) from[k] -= t * edge[k];
      const double square = product(d, from, from);
      if (!(square < best)) continue;
      best = square;
      memset(coordinates, 0, c * sizeof *coordinates);
      coordinates[i] = 1 - t, coordinates[j] = t;
      memcpy(arm, from, d * sizeof *arm);
    }
  return best;
}

void examine(const Surface *s, long n, int k, const double *p, const double *normal, const int *triangle,
             double *coordinates, double *arm, double *distance, double *cosine) {
  const int c = s->c, d = s->d;
  for (long i = 0; i < n * k; ++i) {
    const long t = triangle[i], row = i / k;
    memset(coordinates + c * i, 0, c * sizeof *coordinates);
    memset(arm + d * i, 0, d * sizeof *arm);
    closest_point(c, d, p + d * row, s->corner + c * d * t, coordinates + c * i, arm + d * i);
    distance[i] = sqrt(product(d, arm + d * i, arm + d * i));
    cosine[i] = product(d, s->outward + d * t, normal + d * row);
  }
}

/* The distance of `turned` of a triangle at a distance, with the cosine of the normals. */
static inline double turned(double distance, double cosine, double size) {
  const double beside = (1 + cosine) / 2;
  return distance * (1 + (TURNED - 1) * beside) + BESIDE * size * beside;
}

void closest_targets(const Surface *s, long n, int k, const double *p, const double *normal, const double *size,
                     const int *triangle, int *nearest, double *place, double *arm, double *distance, int *target,
                     double *coordinates) {
  const int c = s->c, d = s->d;
  for (long i = 0; i < n; ++i) {
    double least = INFINITY;
    distance[i] = INFINITY;
    for (int j = 0; j < k; ++j) {
      const long t = triangle[k * i + j];
      double at[3] = {0, 0, 0}, away[3] = {0, 0, 0};
      closest_point(c, d, p + d * i, s->corner + c * d * t, at, away);
      const double length = sqrt(product(d, away, away));
      const double preferred = turned(length, product(d, s->outward + d * t, normal + d * i), size[i]);
      if (j == 0 || length < distance[i]) {
        distance[i] = length, nearest[i] = t;
        memcpy(place + c * i, at, c * sizeof *at);
        memcpy(arm + d * i, away, d * sizeof *away);
      }
      if (j == 0 || preferred < least) {
        least = preferred, target[i] = t;
        memcpy(coordinates + c * i, at, c * sizeof *at);
      }
    }
  }
}

void walk(const Surface *s, long n, int k, const double *p, const double *normal, const double *size, const int *ring,
          int *target, double *coordinates) {
  const int c = s->c, d = s->d;
  for (long i = 0; i < n; ++i) {
    double best = INFINITY;
    for (int step = 0; step < STEPS; ++step) {
      const int *around = ring + (long)k * target[i];
      double least = INFINITY, place[3] = {0, 0, 0};
      int to = -1;
      for (int j = 0; j < k; ++j) {
        const long t = around[j];
        if (j > 0 && t == around[j - 1]) break; /* the rest repeats one triangle */
        double at[3] = {0, 0, 0}, away[3] = {0, 0, 0};
        closest_point(c, d, p + d * i, s->corner + c * d * t, at, away);
        const double length = sqrt(product(d, away, away));
        const double preferred = turned(length, product(d, s->outward + d * t, normal + d * i), size[i]);
        if (to < 0 || preferred < least) {
          least = preferred, to = t;
          memcpy(place, at, sizeof at);
        }
      }
      if (!(least < (1 - CLOSER) * best)) break;
      best = least;
      memcpy(coordinates + c * i, place, c * sizeof *place);
      const int stays = to == target[i];
      target[i] = to;
      if (stays) break;
    }
  }
}

void surface_normals(long m, int d, const int *triangle, const double *x, double *normal, double *weighted) {
  for (long t = 0; t < m; ++t, normal += d, weighted += d * d) {
    const int *point = triangle + d * t;
    double way[3][3]; /* from each corner to the next */
    for (int i = 0; i < d; ++i)
      for (int k = 0; k < d; ++k) way[i][k] = x[d * (long)point[(i + 1) % d] + k] - x[d * (long)point[i] + k];
    if (d == 2) {
      normal[0] = way[0][1], normal[1] = -way[0][0];
      to_unit(2, normal);
      memcpy(weighted, normal, 2 * sizeof *normal);
      memcpy(weighted + 2, normal, 2 * sizeof *normal);
      continue;
    }
    for (int k = 0; k < 3; ++k) { /* ab x ac, with ac = -way[2] */
      const int a = (k + 1) % 3, b = (k + 2) % 3;
      normal[k] = way[0][b] * way[2][a] - way[0][a] * way[2][b];
    }
    const double doubled = sqrt(product(3, normal, normal));
    to_unit(3, normal);
    for (int i = 0; i < 3; ++i) { /* the angle between the way there and the way back */
      const double angle = atan2(doubled, -product(3, way[i], way[(i + 2) % 3]));
      for (int k = 0; k < 3; ++k) weighted[3 * i + k] = angle * normal[k];
    }
  }
}

void averaged_normals(long n, int d, const int *chosen, const double *coordinates, const int *triangle,
                      const double *normal, const double *weighted, const int *start, const int *corner, double sharp,
                      double *found) {
  for (long i = 0; i < n; ++i, found += d) {
    const double *own = normal + d * (long)chosen[i];
    for (int k = 0; k < d; ++k) found[k] = 0;
    for (int a = 0; a < d; ++a) {
      const int point = triangle[d * (long)chosen[i] + a];
      double sum[3] = {0, 0, 0};
      for (int j = start[point]; j < start[point + 1]; ++j)
        if (product(d, normal + d * (long)(corner[j] / d), own) > sharp)
          for (int k = 0; k < d; ++k) sum[k] += weighted[d * (long)corner[j] + k];
      to_unit(d, sum);
      for (int k = 0; k < d; ++k) found[k] += coordinates[d * i + a] * sum[k];
    }
    to_unit(d, found);
  }
}

void rows_intersect(long n, const int *a, const int *a_start, const int *a_column, const int *b, const int *b_start,
                    const int *b_column, unsigned char *common) {
  for (long i = 0; i < n; ++i) {
    int j = a_start[a[i]], k = b_start[b[i]];
    const int a_end = a_start[a[i] + 1], b_end = b_start[b[i] + 1];
    common[i] = 0;
    while (j < a_end && k < b_end) {
      if (a_column[j] == b_column[k]) {
        common[i] = 1;
        break;
      }
      if (a_column[j] < b_column[k])
        ++j;
      else
        ++k;
    }
  }
}
