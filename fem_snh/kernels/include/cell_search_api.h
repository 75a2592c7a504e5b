/* The search for the cells that contain points. The C compiler and cffi read this one file. */

/* Pairs of a point [n][d] and a box low, high [m][d] around it, box by box. Returns their number, and writes at most
 * `room` of them. */
long points_in_boxes(int d, long n, const double *p, long m, const double *low, const double *high, long room, int *point,
                     int *box);

/* A map from a reference cell with k nodes: polynomials in s = 2 xi - 1. */
typedef struct {
  int d, k, simplex;
  const int *power;          /* [k][d] of each monomial */
  const double *coefficient; /* [k monomials][k nodes]: a node's shape function is a column times the monomials */
} CellMap;

/* Positions [n][d] of xi [n][d] in cells with nodes at y [n][k][d], and determinants of dx/dxi [n]. */
void map_points(const CellMap *map, long n, const double *y, const double *xi, double *x, double *det);

/* Reference coordinates of x [n][d], by Newton's method from the reference centre; whether it converged, and how far
 * they are outside of the reference cell, <= 0 inside. */
void invert_map(const CellMap *map, long n, const double *y, const double *x, const double *center, double *xi,
                double *outside, unsigned char *found);
