/* CSR patterns of pairs (row, column) that may repeat, and the index of each pair in the pattern. */
#include <stdlib.h>
#include <string.h>

/* Write the pattern of n pairs: indptr (num_rows + 1), and the columns of each row in ascending order in
   the first indptr[num_rows] entries of indices (n). Two counting sorts, by column and then by row, take
   linear time. Return 1 if memory is exhausted, else 0. */
int block_pattern(long n, const int *rows, const int *columns, long num_rows, long num_columns,
                  long *indptr, int *indices)
{
    int *by_column = malloc((n + 1) * sizeof *by_column);
    long *column_end = calloc(num_columns + 1, sizeof *column_end);
    long *row_end = calloc(num_rows + 1, sizeof *row_end);
    int failed = !by_column || !column_end || !row_end;
    if (!failed) {
        for (long k = 0; k < n; k++) column_end[columns[k] + 1]++;
        for (long c = 0; c < num_columns; c++) column_end[c + 1] += column_end[c];
        /* This moves column_end[c] from the start of column c to its end. */
        for (long k = 0; k < n; k++) by_column[column_end[columns[k]]++] = rows[k];

        memset(indptr, 0, (num_rows + 1) * sizeof *indptr);
        for (long k = 0; k < n; k++) indptr[rows[k] + 1]++;
        for (long r = 0; r < num_rows; r++) indptr[r + 1] += indptr[r];
        memcpy(row_end, indptr, (num_rows + 1) * sizeof *indptr);
        for (long c = 0, k = 0; c < num_columns; c++)
            for (; k < column_end[c]; k++) {
                long r = by_column[k];
                if (row_end[r] == indptr[r] || indices[row_end[r] - 1] != c)
                    indices[row_end[r]++] = (int)c;
            }

        /* Close the gaps that repeated pairs leave. */
        long size = 0;
        for (long r = 0; r < num_rows; r++) {
            long start = indptr[r];
            indptr[r] = size;
            for (long k = start; k < row_end[r]; k++) indices[size++] = indices[k];
        }
        indptr[num_rows] = size;
    }
    free(by_column);
    free(column_end);
    free(row_end);
    return failed;
}

/* Write the index in `indices` of each of n pairs to found (n), by bisection. Return the number of
   pairs that are not in the pattern. */
long block_indices(long n, const int *rows, const int *columns, const long *indptr,
                   const int *indices, long *found)
{
    long missing = 0;
    for (long k = 0; k < n; k++) {
        long low = indptr[rows[k]], end = indptr[rows[k] + 1], high = end;
        while (low < high) {
            long middle = low + (high - low) / 2;
            if (indices[middle] < columns[k]) low = middle + 1;
            else high = middle;
        }
        missing += low == end || indices[low] != columns[k];
        found[k] = low;
    }
    return missing;
}

/* Return the flat indices of the entries of cells (num_cells, n), sorted by the entries' values, in allocated memory;
   those of the value r begin at start[r], start (num_rows + 1). Return NULL if memory is exhausted. */
static long *entries_of_rows(long num_cells, int n, const int *cells, long num_rows, long *start)
{
    const long total = num_cells * n;
    long *entries = malloc((total + 1) * sizeof *entries), *end = malloc((num_rows + 1) * sizeof *end);
    if (entries && end) {
        memset(start, 0, (num_rows + 1) * sizeof *start);
        for (long k = 0; k < total; k++) start[cells[k] + 1]++;
        for (long r = 0; r < num_rows; r++) start[r + 1] += start[r];
        memcpy(end, start, (num_rows + 1) * sizeof *end);
        for (long k = 0; k < total; k++) entries[end[cells[k]]++] = k;
    } else {
        free(entries);
        entries = NULL;
    }
    free(end);
    return entries;
}

/* The pattern of all pairs of blocks of each cell. If indices is NULL, write indptr (num_rows + 1); otherwise read
   indptr and write the columns of each row, ascending: the pattern is symmetric, so these are the rows of each column,
   found in order. Return the number of pairs, or -1 if memory is exhausted. */
long cell_pattern(long num_cells, int n, const int *cells, long num_rows, long *indptr, int *indices)
{
    long *start = malloc((num_rows + 1) * sizeof *start), size = 0;
    long *entries = start ? entries_of_rows(num_cells, n, cells, num_rows, start) : NULL;
    long *end = malloc((num_rows + 1) * sizeof *end);
    int *last = malloc((num_rows + 1) * sizeof *last); /* the last row that has this column */
    if (!entries || !end || !last) size = -1;
    else {
        if (indices) memcpy(end, indptr, (num_rows + 1) * sizeof *end);
        for (long r = 0; r < num_rows; r++) last[r] = -1;
        for (long r = 0; r < num_rows; r++) {
            if (!indices) indptr[r] = size;
            for (long k = start[r]; k < start[r + 1]; k++) {
                const int *cell = cells + entries[k] / n * n;
                for (int j = 0; j < n; j++)
                    if (last[cell[j]] != r) {
                        last[cell[j]] = (int)r;
                        if (indices) indices[end[cell[j]]++] = (int)r;
                        size++;
                    }
            }
        }
        indptr[num_rows] = size;
    }
    free(entries);
    free(start);
    free(end);
    free(last);
    return size;
}

/* Write positions[k], with the pair's index k in the pattern, for each pair of blocks of each cell to found
   (num_cells, n, n). Return 1 if memory is exhausted, else 0. */
int cell_positions(long num_cells, int n, const int *cells, long num_rows, const long *indptr, const int *indices,
                   const int *positions, int *found)
{
    long *start = malloc((num_rows + 1) * sizeof *start);
    long *entries = start ? entries_of_rows(num_cells, n, cells, num_rows, start) : NULL;
    int *of_column = malloc((num_rows + 1) * sizeof *of_column);
    const int failed = !entries || !of_column;
    for (long r = 0; !failed && r < num_rows; r++) {
        for (long k = indptr[r]; k < indptr[r + 1]; k++) of_column[indices[k]] = positions[k];
        for (long k = start[r]; k < start[r + 1]; k++) {
            const int *cell = cells + entries[k] / n * n;
            int *to = found + entries[k] * n;
            for (int j = 0; j < n; j++) to[j] = of_column[cell[j]];
        }
    }
    free(entries);
    free(start);
    free(of_column);
    return failed;
}

/* Write the unknowns of the block columns indices[from] to indices[end - 1] to `to`; return the end of `to`. */
static int *append(const BlockColumns *c, long from, long end, int *to)
{
    for (long k = from; k < end; k++) {
        const int block = c->indices[k];
        for (int i = 0; i < c->size[block]; i++) *to++ = c->unknown[block] + i;
    }
    return to;
}

/* Write the columns of every scalar row of a parallel matrix, ascending. Block row i has row_size[i] equal rows. Its
   columns are the block columns of `others` (other ranks) below `before`, then `own`, then the rest of `others`. */
void unknown_columns(long num_rows, const int *row_size, const BlockColumns *own,
                     const BlockColumns *others, long before, int *columns)
{
    for (long i = 0; i < num_rows; i++) {
        const int *first = columns;
        const long end = others->indptr[i + 1];
        long middle = others->indptr[i];
        while (middle < end && others->indices[middle] < before) middle++;
        columns = append(others, others->indptr[i], middle, columns);
        columns = append(own, own->indptr[i], own->indptr[i + 1], columns);
        columns = append(others, middle, end, columns);
        const long length = columns - first;
        for (int k = 1; k < row_size[i]; k++, columns += length)
            memcpy(columns, first, length * sizeof *columns);
    }
}
