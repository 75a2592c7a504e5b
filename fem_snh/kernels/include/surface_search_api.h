/* Searches on a surface of triangles, in two dimensions of segments. The C compiler and cffi read this one file.
 *
 * A triangle has c corners (3, a segment 2) with d coordinates (c, or 3). */

typedef struct {
  int c, d;
  const double *corner;  /* [triangles][c][d] positions [m] */
  const double *outward; /* [triangles][d] outward unit normals */
} Surface;

/* For each of n points p [n][d] with unit normals [n][d] and k triangles [n][k]: barycentric coordinates [n][k][c] of
 * the closest point of each triangle, the point minus it [n][k][d], the distance [n][k], and the cosine [n][k] of the
 * triangle's normal with the point's. */
void examine(const Surface *s, long n, int k, const double *p, const double *normal, const int *triangle,
             double *coordinates, double *arm, double *distance, double *cosine);

/* Of the k triangles of each point the closest one: its number, coordinates [n][c], arm [n][d] and distance; and the
 * one with the least `turned` distance (fem_snh.contact.triangle_search.turned), with coordinates. `size` [n] is the
 * size of the cells at the points [m]. */
void closest_targets(const Surface *s, long n, int k, const double *p, const double *normal, const double *size,
                     const int *triangle, int *nearest, double *place, double *arm, double *distance, int *target,
                     double *coordinates);

/* From the triangle target [n] of each point, move to the triangle of its ring [triangles][k] with the least `turned`
 * distance while that is smaller; set target, and coordinates [n][c]. */
void walk(const Surface *s, long n, int k, const double *p, const double *normal, const double *size, const int *ring,
          int *target, double *coordinates);

/* Unit normals [m][d] of triangles [m][d] of points x [points][d], and their normals times the angle at each corner,
 * [m][d][d]; of segments times 1. */
void surface_normals(long m, int d, const int *triangle, const double *x, double *normal, double *weighted);

/* Unit normals [n][d] that are interpolated between the corners of the triangles chosen [n]: at a corner, along the sum
 * of `weighted` of the triangles at its point (the corners corner[start[point]..start[point + 1]], numbered triangle by
 * triangle) whose normals have a larger cosine with the chosen one's than `sharp`. */
void averaged_normals(long n, int d, const int *chosen, const double *coordinates, const int *triangle,
                      const double *normal, const double *weighted, const int *start, const int *corner, double sharp,
                      double *found);

/* Which rows a [n] of one CSR pattern and b [n] of another have a common column; columns of a row are sorted. */
void rows_intersect(long n, const int *a, const int *a_start, const int *a_column, const int *b, const int *b_start,
                    const int *b_column, unsigned char *common);
