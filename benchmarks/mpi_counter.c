/* Counts what this rank sends, through the profiling interface of MPI: `benchmarks.scaling` preloads it.
 *
 * A point-to-point message counts where it is sent, with its bytes; a collective call counts once on each rank, with the
 * bytes that the rank contributes. How a collective is made of messages is the matter of the MPI library. Gathered
 * bytes are those that the rank holds after an allgather, a gather to it or a broadcast from another rank. */
#include <mpi.h>
#include <stdlib.h>

static double counts[5]; /* messages, their bytes, collectives, their bytes, gathered bytes */

const double *mpi_counts(void) { return counts; }

static void add(int kind, double items, MPI_Datatype type) {
  int size = 0;
  if (type != MPI_DATATYPE_NULL) PMPI_Type_size(type, &size);
  counts[2 * kind] += 1;
  counts[2 * kind + 1] += items * size;
}

/* A collective of one rank alone is none. */
static void add_collective(MPI_Comm c, double items, MPI_Datatype type) {
  int ranks;
  PMPI_Comm_size(c, &ranks);
  if (ranks > 1) add(1, items, type);
}

static void add_gathered(MPI_Comm c, double items, MPI_Datatype type) {
  int ranks, size;
  PMPI_Comm_size(c, &ranks);
  PMPI_Type_size(type, &size);
  if (ranks > 1) counts[4] += items * size;
}

/* The sum of n[] over the ranks of c. */
static double sum_of_ranks(MPI_Comm c, const int n[]) {
  int ranks;
  double all = 0;
  PMPI_Comm_size(c, &ranks);
  for (int i = 0; i < ranks; i++) all += n[i];
  return all;
}

static double number_of_ranks(MPI_Comm c) { int ranks; PMPI_Comm_size(c, &ranks); return ranks; }
static int rank_of(MPI_Comm c) { int rank; PMPI_Comm_rank(c, &rank); return rank; }

#define SENDING(name, ...)                                                                                       \
  int MPI_##name(const void *b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c __VA_ARGS__) {                 \
    add(0, n, t);                                                                                                \
    return PMPI_##name(b, n, t, to, tag, c

SENDING(Send)); }
SENDING(Ssend)); }
SENDING(Bsend)); }
SENDING(Rsend)); }
SENDING(Isend, , MPI_Request *r), r); }
SENDING(Issend, , MPI_Request *r), r); }
SENDING(Ibsend, , MPI_Request *r), r); }
SENDING(Irsend, , MPI_Request *r), r); }

/* Persistent requests: they are counted where they are started. */
static struct { MPI_Request request; double items; MPI_Datatype type; } *kept;
static int number, room;

int MPI_Send_init(const void *b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c, MPI_Request *r) {
  const int failed = PMPI_Send_init(b, n, t, to, tag, c, r);
  int at = 0;
  while (at < number && kept[at].request != *r) at++;
  if (at == room) kept = realloc(kept, sizeof *kept * (room = 2 * room + 64));
  if (at == number) number++;
  kept[at].request = *r, kept[at].items = n, kept[at].type = t;
  return failed;
}

static void start(MPI_Request request) {
  for (int at = 0; at < number; at++)
    if (kept[at].request == request) { add(0, kept[at].items, kept[at].type); return; }
}

int MPI_Recv_init(void *b, int n, MPI_Datatype t, int from, int tag, MPI_Comm c, MPI_Request *r) {
  const int failed = PMPI_Recv_init(b, n, t, from, tag, c, r);
  for (int at = 0; at < number; at++) /* a freed request's handle is used again */
    if (kept[at].request == *r) kept[at] = kept[--number];
  return failed;
}

int MPI_Start(MPI_Request *r) { start(*r); return PMPI_Start(r); }

int MPI_Startall(int n, MPI_Request r[]) {
  for (int i = 0; i < n; i++) start(r[i]);
  return PMPI_Startall(n, r);
}

int MPI_Barrier(MPI_Comm c) { add_collective(c, 0, MPI_DATATYPE_NULL); return PMPI_Barrier(c); }

int MPI_Bcast(void *b, int n, MPI_Datatype t, int root, MPI_Comm c) {
  add_collective(c, n, t);
  if (rank_of(c) != root) add_gathered(c, n, t);
  return PMPI_Bcast(b, n, t, root, c);
}

int MPI_Reduce(const void *s, void *r, int n, MPI_Datatype t, MPI_Op o, int root, MPI_Comm c) {
  add_collective(c, n, t);
  return PMPI_Reduce(s, r, n, t, o, root, c);
}

#define REDUCING(name)                                                                             \
  int MPI_##name(const void *s, void *r, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c) {             \
    add_collective(c, n, t);                                                                                  \
    return PMPI_##name(s, r, n, t, o, c);                                                          \
  }

REDUCING(Allreduce)
REDUCING(Scan)
REDUCING(Exscan)
REDUCING(Reduce_scatter_block)

int MPI_Iallreduce(const void *s, void *r, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c, MPI_Request *q) {
  add_collective(c, n, t);
  return PMPI_Iallreduce(s, r, n, t, o, c, q);
}

int MPI_Ibcast(void *b, int n, MPI_Datatype t, int root, MPI_Comm c, MPI_Request *q) {
  add_collective(c, n, t);
  return PMPI_Ibcast(b, n, t, root, c, q);
}

int MPI_Allgather(const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, MPI_Comm c) {
  add_collective(c, n, s == MPI_IN_PLACE ? MPI_DATATYPE_NULL : t);
  add_gathered(c, m * number_of_ranks(c), u);
  return PMPI_Allgather(s, n, t, r, m, u, c);
}

int MPI_Allgatherv(const void *s, int n, MPI_Datatype t, void *r, const int m[], const int d[], MPI_Datatype u, MPI_Comm c) {
  add_collective(c, n, s == MPI_IN_PLACE ? MPI_DATATYPE_NULL : t);
  add_gathered(c, sum_of_ranks(c, m), u);
  return PMPI_Allgatherv(s, n, t, r, m, d, u, c);
}

int MPI_Gather(const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, int root, MPI_Comm c) {
  add_collective(c, n, s == MPI_IN_PLACE ? MPI_DATATYPE_NULL : t);
  if (rank_of(c) == root) add_gathered(c, m * number_of_ranks(c), u);
  return PMPI_Gather(s, n, t, r, m, u, root, c);
}

int MPI_Gatherv(const void *s, int n, MPI_Datatype t, void *r, const int m[], const int d[], MPI_Datatype u, int root, MPI_Comm c) {
  add_collective(c, n, s == MPI_IN_PLACE ? MPI_DATATYPE_NULL : t);
  if (rank_of(c) == root) add_gathered(c, sum_of_ranks(c, m), u);
  return PMPI_Gatherv(s, n, t, r, m, d, u, root, c);
}

int MPI_Alltoall(const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, MPI_Comm c) {
  int size;
  PMPI_Comm_size(c, &size);
  add_collective(c, (double)n * size, s == MPI_IN_PLACE ? MPI_DATATYPE_NULL : t);
  return PMPI_Alltoall(s, n, t, r, m, u, c);
}

int MPI_Alltoallv(const void *s, const int n[], const int d[], MPI_Datatype t, void *r, const int m[], const int e[],
                  MPI_Datatype u, MPI_Comm c) {
  int size;
  double all = 0;
  PMPI_Comm_size(c, &size);
  for (int i = 0; i < size && s != MPI_IN_PLACE; i++) all += n[i];
  add_collective(c, all, s == MPI_IN_PLACE ? MPI_DATATYPE_NULL : t);
  return PMPI_Alltoallv(s, n, d, t, r, m, e, u, c);
}

int MPI_Scatterv(const void *s, const int n[], const int d[], MPI_Datatype t, void *r, int m, MPI_Datatype u, int root, MPI_Comm c) {
  add_collective(c, m, u);
  return PMPI_Scatterv(s, n, d, t, r, m, u, root, c);
}

int MPI_Scatter(const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, int root, MPI_Comm c) {
  add_collective(c, m, u);
  return PMPI_Scatter(s, n, t, r, m, u, root, c);
}

int MPI_Ibarrier(MPI_Comm c, MPI_Request *q) { add_collective(c, 0, MPI_DATATYPE_NULL); return PMPI_Ibarrier(c, q); }

int MPI_Sendrecv(const void *s, int n, MPI_Datatype t, int to, int a, void *r, int m, MPI_Datatype u, int from, int b,
                 MPI_Comm c, MPI_Status *status) {
  add(0, n, t);
  return PMPI_Sendrecv(s, n, t, to, a, r, m, u, from, b, c, status);
}

/* The neighbourhood collectives of dolfinx are messages to each neighbour. */
static int neighbours(MPI_Comm c) {
  int in, out, weighted;
  PMPI_Dist_graph_neighbors_count(c, &in, &out, &weighted);
  return out;
}

int MPI_Neighbor_alltoall(const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, MPI_Comm c) {
  for (int i = neighbours(c); i > 0; i--) add(0, n, t);
  return PMPI_Neighbor_alltoall(s, n, t, r, m, u, c);
}

int MPI_Neighbor_alltoallv(const void *s, const int n[], const int d[], MPI_Datatype t, void *r, const int m[], const int e[],
                           MPI_Datatype u, MPI_Comm c) {
  for (int i = neighbours(c) - 1; i >= 0; i--) add(0, n[i], t);
  return PMPI_Neighbor_alltoallv(s, n, d, t, r, m, e, u, c);
}

int MPI_Ineighbor_alltoallv(const void *s, const int n[], const int d[], MPI_Datatype t, void *r, const int m[], const int e[],
                            MPI_Datatype u, MPI_Comm c, MPI_Request *q) {
  for (int i = neighbours(c) - 1; i >= 0; i--) add(0, n[i], t);
  return PMPI_Ineighbor_alltoallv(s, n, d, t, r, m, e, u, c, q);
}

/* MUMPS calls MPI from Fortran, whose functions do not go through those of C. */
#define FORTRAN_SENDING(name)                                                                          \
  void pmpi_##name##_(void *b, int *n, int *t, int *to, int *tag, int *c, int *e);                      \
  void mpi_##name##_(void *b, int *n, int *t, int *to, int *tag, int *c, int *e) {                      \
    add(0, *n, MPI_Type_f2c(*t));                                                                      \
    pmpi_##name##_(b, n, t, to, tag, c, e);                                                            \
  }

FORTRAN_SENDING(send)
FORTRAN_SENDING(ssend)

void pmpi_isend_(void *b, int *n, int *t, int *to, int *tag, int *c, int *r, int *e);
void mpi_isend_(void *b, int *n, int *t, int *to, int *tag, int *c, int *r, int *e) {
  add(0, *n, MPI_Type_f2c(*t));
  pmpi_isend_(b, n, t, to, tag, c, r, e);
}

void pmpi_bcast_(void *b, int *n, int *t, int *root, int *c, int *e);
void mpi_bcast_(void *b, int *n, int *t, int *root, int *c, int *e) {
  add_collective(MPI_Comm_f2c(*c), *n, MPI_Type_f2c(*t));
  pmpi_bcast_(b, n, t, root, c, e);
}

void pmpi_allreduce_(void *s, void *r, int *n, int *t, int *o, int *c, int *e);
void mpi_allreduce_(void *s, void *r, int *n, int *t, int *o, int *c, int *e) {
  add_collective(MPI_Comm_f2c(*c), *n, MPI_Type_f2c(*t));
  pmpi_allreduce_(s, r, n, t, o, c, e);
}

void pmpi_reduce_(void *s, void *r, int *n, int *t, int *o, int *root, int *c, int *e);
void mpi_reduce_(void *s, void *r, int *n, int *t, int *o, int *root, int *c, int *e) {
  add_collective(MPI_Comm_f2c(*c), *n, MPI_Type_f2c(*t));
  pmpi_reduce_(s, r, n, t, o, root, c, e);
}

void pmpi_barrier_(int *c, int *e);
void mpi_barrier_(int *c, int *e) {
  add_collective(MPI_Comm_f2c(*c), 0, MPI_DATATYPE_NULL);
  pmpi_barrier_(c, e);
}

void pmpi_gather_(void *s, int *n, int *t, void *r, int *m, int *u, int *root, int *c, int *e);
void mpi_gather_(void *s, int *n, int *t, void *r, int *m, int *u, int *root, int *c, int *e) {
  add_collective(MPI_Comm_f2c(*c), *n, MPI_Type_f2c(*t));
  pmpi_gather_(s, n, t, r, m, u, root, c, e);
}

void pmpi_alltoall_(void *s, int *n, int *t, void *r, int *m, int *u, int *c, int *e);
void mpi_alltoall_(void *s, int *n, int *t, void *r, int *m, int *u, int *c, int *e) {
  int size;
  MPI_Comm comm = MPI_Comm_f2c(*c);
  PMPI_Comm_size(comm, &size);
  add_collective(comm, (double)*n * size, MPI_Type_f2c(*t));
  pmpi_alltoall_(s, n, t, r, m, u, c, e);
}
