/* Walks along pairs of contours: the loops of walking.py that no array operation expresses.
 *
 * A walk goes around the contour below and the contour above of a pair, in as many steps as both
 * have edges. Each step is a triangle: a rise over an edge below, or a run over an edge above.
 */

#include "_module.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { CANDIDATES = 8 }; /* vertices of a contour that a walk may begin at */
enum { EXPECTATIONS = 7 }; /* numbers that a pair of contours suggests of its band */
enum { FITS = 3 }; /* numbers that tell how a band fits */
enum { REACH = 8, WINDOW = 2 * REACH + 1 }; /* walks around one, see `improve` */
enum { ROUNDS = 8 }; /* windows, one after the other: more than three were never needed */
static const double TIE = 1e-6; /* relatively: choices that differ by less are rounding's */
static const double TIE_OF_SUMS = 1e-9; /* the same of areas added up, whose choices add up too */
static const double TIE_OF_MISFITS = 1e-6; /* walks that fit better by less do so by rounding */
static const double VOLUME_WEIGHT = 5.0; /* of a band's error in volume against one in area */
static const double DOUBTFUL_MISFIT = 0.05; /* bands above are worth the second look */
static const double WORTHWHILE = 0.8; /* of a misfit: who gains less smooths rough contours */

/* The arrays of a call, checked. */
typedef struct {
    const double *points;  /* (n, 3): contours, one behind the other */
    const int64_t *first;  /* (rings + 1,): where each contour begins, and where the last ends */
    const int64_t *pairs;  /* (bands, 2): the contours below and above */
    const double *shifts;  /* (bands, 2): by which contours above are taken back */
    const double *expected; /* (bands, EXPECTATIONS): see `expect_all` */
    int64_t *starts;       /* (bands, 2): where the walks begin, or -1 where there is none yet */
    uint8_t *rises;        /* (steps,): walk by walk, 1 for a rise and 0 for a run */
    double *fits;          /* (bands, FITS): area, flux of (0, 0, z) upward, and misfit */
    Py_ssize_t bands;
} Work;

/* The vertices around contours, with those that have been put on their edges. */
typedef struct {
    const int64_t *order;    /* (m,) */
    const int64_t *ends;     /* (n + 1,): where in `order` each of the contours' own vertices is */
    const uint8_t *is_laid;  /* (bands,): between which of the contours there are triangles */
} Divisions;

/* A contour from the vertex that a walk begins at, and back to it; x and y shifted. */
typedef struct {
    int64_t count;
    double *x, *y;
    double z, shift[2];
} Path;

/* Compiled for vectors of four numbers too where a processor has them; the results are the same. */
#if defined(__GLIBC__) && defined(__x86_64__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

static int64_t count_of(const Work *work, int64_t ring)
{
    return work->first[ring + 1] - work->first[ring];
}

/* Choose the nearest pair of a few vertices below and all above, the first of those as near. */
static void choose_start(const Work *work, Py_ssize_t band, int64_t *start)
{
    const int64_t *pair = work->pairs + 2 * band;
    const double *low = work->points + 3 * work->first[pair[0]];
    const double *high = work->points + 3 * work->first[pair[1]];
    const int64_t below = count_of(work, pair[0]), above = count_of(work, pair[1]);
    const double height = high[2] - low[2];
    double clearly_less = INFINITY;
    start[0] = start[1] = 0;
    for (int candidate = 0; candidate < CANDIDATES; candidate++) {
        const int64_t row = below * candidate / CANDIDATES;
        const double x = low[3 * row] + work->shifts[2 * band];
        const double y = low[3 * row + 1] + work->shifts[2 * band + 1];
        for (int64_t column = 0; column < above; column++) {
            const double aside = high[3 * column] - x, ahead = high[3 * column + 1] - y;
            const double square = aside * aside + ahead * ahead + height * height;
            if (square < clearly_less) {
                clearly_less = (1 - TIE) * square;
                start[0] = row;
                start[1] = column;
            }
        }
    }
}

/* Lay a contour's vertices out in the order of a walk; `room` takes 2 (count + 1) numbers. */
static Path path_of(const Work *work, Py_ssize_t band, int side, int64_t start, double *room)
{
    const int64_t ring = work->pairs[2 * band + side];
    const double *points = work->points + 3 * work->first[ring];
    Path path = {.count = count_of(work, ring), .z = points[2]};
    path.x = room;
    path.y = path.x + path.count + 1;
    if (side && work->shifts != NULL) {
        path.shift[0] = work->shifts[2 * band];
        path.shift[1] = work->shifts[2 * band + 1];
    }
    for (int64_t place = 0; place <= path.count; place++) {
        const int64_t vertex = start + place - (start + place < path.count ? 0 : path.count);
        const double *point = points + 3 * vertex;
        path.x[place] = point[0] - path.shift[0];
        path.y[place] = point[1] - path.shift[1];
    }
    return path;
}

/* Walk by the shorter of the two diagonals, and rise where they are as long. */
static void walk_greedily(const Path *low, const Path *high, uint8_t *rises)
{
    const double height = high->z - low->z, near_tie = TIE * (height * height);
    int64_t row = 0, column = 0;
    while (row < low->count && column < high->count) {
        const double rise_x = low->x[row + 1] - high->x[column];
        const double rise_y = low->y[row + 1] - high->y[column];
        const double run_x = low->x[row] - high->x[column + 1];
        const double run_y = low->y[row] - high->y[column + 1];
        const double run = run_x * run_x + run_y * run_y;
        if (rise_x * rise_x + rise_y * rise_y <= (1 + TIE) * run + near_tie) {
            *rises++ = 1;
            row++;
        } else {
            *rises++ = 0;
            column++;
        }
    }
    memset(rises, 1, (size_t)(low->count - row));
    memset(rises + low->count - row, 0, (size_t)(high->count - column));
}

/* The vertices of a path with the edges that lead to them, in either order, for `improve`. */
typedef struct {
    double *x, *y, *edge_x, *edge_y, *upright;
} Line;

/* Lay out a path, and on both sides of it as many places as a window reaches, which no edge leads
 * to, as none leads to the first vertex; `room` takes 5 (count + 1 + 2 REACH) numbers. */
static Line line_of(const Path *path, double height, int is_backward, double *room)
{
    const int64_t size = path->count + 1 + 2 * REACH;
    double *const x = room + REACH;
    const Line line = {x, x + size, x + 2 * size, x + 3 * size, x + 4 * size};
    for (int64_t place = -REACH; place <= path->count + REACH; place++) {
        const int64_t vertex = is_backward ? path->count - place : place;
        const int is_led_to = vertex > 0 && vertex <= path->count;
        const int64_t at = is_led_to ? vertex : 0, before = at - is_led_to;
        const double edge_x = path->x[at] - path->x[before];
        const double edge_y = path->y[at] - path->y[before];
        line.x[place] = path->x[at];
        line.y[place] = path->y[at];
        line.edge_x[place] = edge_x;
        line.edge_y[place] = edge_y;
        line.upright[place] =
            is_led_to ? height * height * (edge_x * edge_x + edge_y * edge_y) : INFINITY;
    }
    return line;
}

/* Take a step in all of a window: to the least areas so far, twice, add the triangles that rise or
 * run to each row. Write the least, and by how much rises are better, or not worse. */
WIDE static void step_to(const Line *low, int64_t row, const Line *high, int64_t column,
                         const double *restrict least, double *restrict next,
                         double *restrict gains)
{
    const double *x = low->x + row, *y = low->y + row, *upright = low->upright + row;
    const double *edge_x = low->edge_x + row, *edge_y = low->edge_y + row;
    const double *high_x = high->x + column, *high_y = high->y + column;
    const double *run_x = high->edge_x + column, *run_y = high->edge_y + column;
    const double *run_upright = high->upright + column;
    for (int place = 0; place < WINDOW; place++) {
        const double over_x = high_x[place] - x[place], over_y = high_y[place] - y[place];
        const double rise = edge_x[place] * over_y - edge_y[place] * over_x;
        const double run = run_x[place] * over_y - run_y[place] * over_x;
        const double by_rise = least[place - 1] + sqrt(rise * rise + upright[place]);
        const double by_run = least[place] + sqrt(run * run + run_upright[place]);
        next[place] = by_rise < by_run ? by_rise : by_run;
        gains[place] = (1 + TIE_OF_SUMS) * by_run - by_rise;
    }
}

/* Find the walk of the least area in a window around a walk, by dynamic programming.
 *
 * After as many steps, such walks have passed up to REACH vertices below more or less. Back from
 * the end they rise where that is as good. `least` and `next` take the rows that windows reach and
 * the one before, `gains` the window of each step. Tell whether the walk that was found runs along
 * the window's border, so that there may be a better one beyond. Where areas are no numbers the
 * walk is left as it is.
 */
static int improve(const Line *low, int64_t rows, const Line *high, int64_t columns,
                   double *least, double *next, double *gains, uint8_t *rises)
{
    for (int64_t row = -REACH - 1; row <= rows + REACH; row++)
        least[row] = next[row] = INFINITY;
    least[0] = 0.0;
    int64_t middle = 0;
    for (int64_t step = 1; step <= rows + columns; step++) {
        middle += rises[step - 1];
        const int64_t from = middle - REACH, column = columns - step + from; /* from the last */
        step_to(low, from, high, column, least + from, next + from, gains + (step - 1) * WINDOW);
        next[from - 1] = INFINITY;
        double *const passed = least;
        least = next;
        next = passed;
    }
    if (!(least[rows] < DBL_MAX / 2))
        return 0;
    int64_t row = rows;
    int is_at_border = 0;
    for (int64_t step = rows + columns; step > 0; step--) {
        const int64_t place = row - middle + REACH;
        const uint8_t rise = gains[(step - 1) * WINDOW + place] >= 0;
        is_at_border |= place == 0 || place == WINDOW - 1;
        middle -= rises[step - 1];
        rises[step - 1] = rise;
        row -= rise;
    }
    return is_at_border;
}

/* Improve a walk as long as there may be something better; `room` takes 7 numbers and
 * a window a vertex, and 24 REACH. */
static void walk_least(const Path *low, const Path *high, double *room, uint8_t *rises)
{
    const int64_t rows = low->count, columns = high->count;
    const double height = high->z - low->z;
    const Line below = line_of(low, height, 0, room);
    const Line above = line_of(high, height, 1, room + 5 * (rows + 1 + 2 * REACH));
    double *least = room + 5 * (rows + columns + 2 + 4 * REACH) + REACH + 1;
    double *next = least + rows + 2 + 2 * REACH, *gains = next + rows + 1 + REACH;
    for (int round = 0; round < ROUNDS; round++)
        if (!improve(&below, rows, &above, columns, least, next, gains, rises))
            break;
}

/* Tell whether a walk goes around one contour in one go, and so uses an edge across twice. */
static int is_pinched(const uint8_t *rises, int64_t steps)
{
    int64_t falls = (rises[steps - 1] != 0) & (rises[0] == 0);
    for (int64_t step = 0; step + 1 < steps; step++)
        falls += (rises[step] != 0) & (rises[step + 1] == 0);
    return falls == 1;
}

/* Exchange two steps of such a walk. */
static void unpinch(uint8_t *rises, int64_t steps)
{
    for (int64_t step = 0; step + 1 < steps; step++) {
        if (rises[step] != rises[step + 1]) {
            rises[step] ^= 1;
            rises[step + 1] ^= 1;
            return;
        }
    }
}

/* Return by how much area and volume exceed or miss what is expected, relatively.
 *
 * The volume is the flux of (0, 0, z) through the band and the caps at both ends.
 */
static double misfit_of(double area, double flux, const double *expected)
{
    const double excess = area / expected[0] - 1;
    const double lack = fabs((flux + expected[3]) / expected[2] - 1);
    return (excess < 0 ? 0.0 : excess) + VOLUME_WEIGHT * lack;
}

/* Add up the triangles of a walk where the contours really are. A pinched one fits nothing. */
static void measure(const Path *low, const Path *high, const uint8_t *rises,
                    const double *expected, double *fit)
{
    const double shift_x = high->shift[0], shift_y = high->shift[1];
    const double height = high->z - low->z;
    double area = 0.0, flux = 0.0;
    const double z[2] = {high->z - height / 3, low->z + height / 3};
    int64_t row = 0, column = 0;
    for (int64_t step = 0; step < low->count + high->count; step++) {
        const int rise = rises[step];
        const double x = high->x[column] + shift_x - low->x[row];
        const double y = high->y[column] + shift_y - low->y[row];
        double edge_x, edge_y;
        if (rise) {
            edge_x = low->x[row + 1] - low->x[row];
            edge_y = low->y[row + 1] - low->y[row];
            row++;
        } else {
            edge_x = high->x[column + 1] - high->x[column];
            edge_y = high->y[column + 1] - high->y[column];
            column++;
        }
        const double beside = edge_x * y - edge_y * x;
        area += sqrt(beside * beside + height * height * (edge_x * edge_x + edge_y * edge_y)) / 2;
        flux += z[rise] * beside / 2;
    }
    fit[0] = is_pinched(rises, low->count + high->count) ? INFINITY : area;
    fit[1] = flux;
    fit[2] = misfit_of(fit[0], flux, expected);
}

/* Walk along a pair, or improve the walk there is. Keep what fits clearly better than that, or is
 * the first; return whether the memory sufficed. */
static int walk_along(const Work *work, Py_ssize_t band, int is_least, uint8_t *rises)
{
    int64_t *starts = work->starts + 2 * band, start[2] = {starts[0], starts[1]};
    const int64_t below = count_of(work, work->pairs[2 * band]);
    const int64_t above = count_of(work, work->pairs[2 * band + 1]);
    const size_t steps = (size_t)(below + above), most = (9 + WINDOW) * (steps + 2) + 24 * REACH;
    double *room = malloc((is_least ? most : 2 * (steps + 2)) * sizeof(double));
    uint8_t *walk = malloc(steps);
    const int has_room = room != NULL && walk != NULL;
    if (has_room && !is_least)
        choose_start(work, band, start);
    if (has_room) {
        const Path low = path_of(work, band, 0, start[0], room);
        const Path high = path_of(work, band, 1, start[1], room + 2 * (below + 1));
        double fit[FITS], *const known = work->fits + FITS * band;
        if (is_least) {
            memcpy(walk, rises, steps);
            walk_least(&low, &high, room + 2 * (steps + 2), walk);
            if (is_pinched(walk, below + above))
                unpinch(walk, below + above);
        } else {
            walk_greedily(&low, &high, walk);
        }
        measure(&low, &high, walk, work->expected + EXPECTATIONS * band, fit);
        if (starts[0] < 0 || fit[2] < WORTHWHILE * known[2] - TIE_OF_MISFITS) {
            memcpy(starts, start, sizeof(start));
            memcpy(rises, walk, steps);
            memcpy(known, fit, sizeof(fit));
        }
    }
    free(room);
    free(walk);
    return has_room;
}

/* Walk along all pairs that have no walk yet or a doubtful one, or improve all doubtful ones;
 * return whether the memory sufficed. */
static int walk_all(const Work *work, int is_least)
{
    uint8_t *rises = work->rises;
    int has_room = 1;
    for (Py_ssize_t band = 0; band < work->bands && has_room; band++) {
        if (work->starts[2 * band] < 0 || work->fits[FITS * band + 2] > DOUBTFUL_MISFIT)
            has_room = walk_along(work, band, is_least, rises);
        rises += count_of(work, work->pairs[2 * band]) + count_of(work, work->pairs[2 * band + 1]);
    }
    return has_room;
}

/* What a contour measures. */
typedef struct {
    double length, area, centroid[2], height;
} Ring;

static Ring measure_ring(const Work *work, int64_t ring)
{
    const double *points = work->points + 3 * work->first[ring];
    const int64_t count = count_of(work, ring);
    double length = 0.0, doubled = 0.0, moment_x = 0.0, moment_y = 0.0;
    double x = points[3 * (count - 1)] - points[0], y = points[3 * (count - 1) + 1] - points[1];
    for (int64_t vertex = 0; vertex < count; vertex++) { /* as seen from the first vertex */
        const double next_x = points[3 * vertex] - points[0];
        const double next_y = points[3 * vertex + 1] - points[1];
        const double edge_x = next_x - x, edge_y = next_y - y, cross = x * next_y - next_x * y;
        length += sqrt(edge_x * edge_x + edge_y * edge_y);
        doubled += cross;
        moment_x += cross * (x + next_x);
        moment_y += cross * (y + next_y);
        x = next_x;
        y = next_y;
    }
    const double centroid_x = points[0] + moment_x / (3 * doubled);
    const double centroid_y = points[1] + moment_y / (3 * doubled);
    return (Ring){length, doubled / 2, {centroid_x, centroid_y}, points[2]};
}

/* Return the area that the edges of a contour sweep on a shift upward. */
static double swept_area(const Work *work, int64_t ring, const double *shift)
{
    const double *points = work->points + 3 * work->first[ring];
    const int64_t count = count_of(work, ring);
    double area = 0.0;
    for (int64_t vertex = 0; vertex < count; vertex++) {
        const double *end = points + 3 * (vertex + 1 < count ? vertex + 1 : 0);
        const double x = end[0] - points[3 * vertex], y = end[1] - points[3 * vertex + 1];
        const double upward = x * shift[1] - y * shift[0];
        area += sqrt(shift[2] * shift[2] * (x * x + y * y) + upward * upward);
    }
    return area;
}

/* Write what each pair of contours suggests of the band between them:
 *
 * its area, were one contour the other's image, scaled; what a shift from one centroid to the other
 * would add to that, relatively; the volume between the contours, negative for holes; what the caps
 * contribute to it, see `misfit_of`; the area of a surface that is level where the contours differ
 * and upright elsewhere, did one contain the other (it is larger else); and the shift, x and y.
 */
static void expect_all(const Work *work, double *expected)
{
    for (Py_ssize_t band = 0; band < work->bands; band++, expected += EXPECTATIONS) {
        const int64_t *pair = work->pairs + 2 * band;
        const Ring low = measure_ring(work, pair[0]), high = measure_ring(work, pair[1]);
        const double height = high.height - low.height, widening = high.area - low.area;
        const double shift[3] = {high.centroid[0] - low.centroid[0],
                                 high.centroid[1] - low.centroid[1], height};
        const double slanted = swept_area(work, pair[0], shift) + swept_area(work, pair[1], shift);
        const double upright = height * (low.length + high.length) / 2;
        const double area = hypot(upright, widening);
        const double between = copysign(sqrt(fabs(low.area * high.area)), low.area);
        expected[0] = area;
        expected[1] = hypot(slanted / 2, widening) / area - 1;
        expected[2] = height * (low.area + high.area + between) / 3;
        expected[3] = high.height * high.area - low.height * low.area;
        expected[4] = upright + fabs(widening);
        expected[5] = shift[0];
        expected[6] = shift[1];
    }
}

/* Write the triangles over an edge of a contour, divided where vertices have been put on it. */
static int64_t *lay_over(const Divisions *divisions, int64_t edge, int64_t end, int64_t apex,
                         int is_above, int64_t *triangles)
{
    const int64_t last = divisions->ends[edge + 1] - 1;
    for (int64_t place = divisions->ends[edge]; place <= last; place++, triangles += 3) {
        const int64_t here = divisions->order[place];
        triangles[0] = is_above ? apex : here;
        triangles[1] = place < last ? divisions->order[place + 1] : end;
        triangles[2] = is_above ? here : apex;
    }
    return triangles;
}

/* Write the triangles of walks. */
static void lay_all(const Work *work, const Divisions *divisions, int64_t *triangles)
{
    const uint8_t *rises = work->rises;
    for (Py_ssize_t band = 0; band < work->bands; band++) {
        int64_t first[2], last[2], at[2], next[2], steps = 0;
        for (int side = 0; side < 2; side++) {
            const int64_t ring = work->pairs[2 * band + side];
            first[side] = work->first[ring];
            last[side] = work->first[ring + 1] - 1;
            at[side] = first[side] + work->starts[2 * band + side];
            next[side] = at[side] == last[side] ? first[side] : at[side] + 1;
            steps += count_of(work, ring);
        }
        for (int64_t step = 0; step < steps && divisions->is_laid[band]; step++) {
            const int side = !rises[step];
            triangles = lay_over(divisions, at[side], next[side], at[!side], side, triangles);
            at[side] = next[side];
            next[side] = at[side] == last[side] ? first[side] : at[side] + 1;
        }
        rises += steps;
    }
}

/* --- arrays from Python ------------------------------------------------------------------- */

static const char EXPECTED[] =
    "Expected contours with vertices, pairs of them, and arrays that agree";

static const ArrayKind POINTS = {"points", 'd', 3, 0}, FIRST = {"first", 'q', 0, 0};
static const ArrayKind PAIRS = {"pairs", 'q', 2, 0};

/* Tell whether contours, pairs of them and so many vertices and steps agree. */
static int are_consistent(const Work *work, const Py_buffer *first, Py_ssize_t vertices,
                          Py_ssize_t all_steps)
{
    if (!are_ends(first, vertices, 1)
        || !are_within(work->pairs, 2 * work->bands, first->shape[0] - 1))
        return 0;
    int64_t steps = 0;
    for (Py_ssize_t place = 0; place < 2 * work->bands; place++)
        steps += count_of(work, work->pairs[place]);
    return all_steps < 0 || steps == all_steps;
}

/* Tell whether walks begin at their contours and go around them once. */
static int are_walks(const Work *work)
{
    const uint8_t *rises = work->rises;
    for (Py_ssize_t band = 0; band < work->bands; band++) {
        int64_t counts[2], risen = 0;
        uint8_t most = 0;
        for (int side = 0; side < 2; side++) {
            const int64_t start = work->starts[2 * band + side];
            counts[side] = count_of(work, work->pairs[2 * band + side]);
            if (start < 0 || start >= counts[side])
                return 0;
        }
        for (int64_t step = 0; step < counts[0] + counts[1]; step++, rises++) {
            risen += *rises;
            most |= *rises;
        }
        if (risen != counts[0] || most > 1)
            return 0;
    }
    return 1;
}

/* Tell whether so many vertices lie around the contours, which make so many triangles. */
static int are_divisions(const Work *work, const Divisions *divisions, const Py_buffer *ends,
                         Py_ssize_t vertices, Py_ssize_t triangles)
{
    if (!are_ends(ends, vertices, 0))
        return 0;
    for (Py_ssize_t place = 0; place < 2 * work->bands; place++) {
        const int64_t *first = work->first + work->pairs[place];
        if (divisions->is_laid[place / 2])
            triangles -= divisions->ends[first[1]] - divisions->ends[first[0]];
    }
    return triangles == 0;
}

static PyObject *walk(PyObject *const *arguments, Py_ssize_t count, int is_least)
{
    const ArrayKind expected[] = {
        POINTS, FIRST, PAIRS, {"expected", 'd', EXPECTATIONS, 0}, {"starts", 'q', 2, 1},
        {"rises", '?', 0, 1}, {"fits", 'd', FITS, 1}, {"shifts", 'd', 2, 0},
    };
    const int arrays = is_least ? 7 : 8;
    Py_buffer views[8];
    if (!get_arrays(arguments, count, expected, arrays, views))
        return NULL;
    const Work work = {.points = views[0].buf, .first = views[1].buf, .pairs = views[2].buf,
                       .expected = views[3].buf, .starts = views[4].buf, .rises = views[5].buf,
                       .fits = views[6].buf, .shifts = is_least ? NULL : views[7].buf,
                       .bands = views[2].shape[0]};
    int good = 1, is_done = 1;
    for (int array = 3; array < arrays; array++)
        good = good && (array == 5 || views[array].shape[0] == work.bands);
    good = good && are_consistent(&work, &views[1], views[0].shape[0], views[5].shape[0])
           && (!is_least || are_walks(&work));
    Py_BEGIN_ALLOW_THREADS
    is_done = !good || walk_all(&work, is_least);
    Py_END_ALLOW_THREADS
    return ended(views, arrays, good, is_done, EXPECTED);
}

static PyObject *greedy(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    return walk(arguments, count, 0);
}

static PyObject *least(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    return walk(arguments, count, 1);
}

static PyObject *expect(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    const ArrayKind expected[] = {POINTS, FIRST, PAIRS, {"expected", 'd', EXPECTATIONS, 1}};
    Py_buffer views[4];
    if (!get_arrays(arguments, count, expected, 4, views))
        return NULL;
    const Work work = {.points = views[0].buf, .first = views[1].buf, .pairs = views[2].buf,
                       .bands = views[2].shape[0]};
    const int good = views[3].shape[0] == work.bands
                     && are_consistent(&work, &views[1], views[0].shape[0], -1);
    Py_BEGIN_ALLOW_THREADS
    if (good)
        expect_all(&work, views[3].buf);
    Py_END_ALLOW_THREADS
    return ended(views, 4, good, 1, EXPECTED);
}

static PyObject *lay(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    const ArrayKind expected[] = {
        FIRST, PAIRS, {"starts", 'q', 2, 0}, {"rises", '?', 0, 0}, {"is_laid", '?', 0, 0},
        {"order", 'q', 0, 0}, {"ends", 'q', 0, 0}, {"triangles", 'q', 3, 1},
    };
    Py_buffer views[8];
    if (!get_arrays(arguments, count, expected, 8, views))
        return NULL;
    const Work work = {.first = views[0].buf, .pairs = views[1].buf, .starts = views[2].buf,
                       .rises = views[3].buf, .bands = views[1].shape[0]};
    const Divisions divisions = {views[5].buf, views[6].buf, views[4].buf};
    const Py_ssize_t own = views[6].shape[0] - 1;
    const int good = views[2].shape[0] == work.bands && views[4].shape[0] == work.bands
                     && are_consistent(&work, &views[0], own, views[3].shape[0])
                     && are_walks(&work)
                     && are_divisions(&work, &divisions, &views[6], views[5].shape[0],
                                      views[7].shape[0]);
    Py_BEGIN_ALLOW_THREADS
    if (good)
        lay_all(&work, &divisions, views[7].buf);
    Py_END_ALLOW_THREADS
    return ended(views, 8, good, 1, EXPECTED);
}

static PyMethodDef METHODS[] = {
    METHOD(greedy, "Walk by the shorter of the two diagonals."),
    METHOD(least, "Improve walks so that the triangles have the least area in total."),
    METHOD(expect, "Measure pairs of contours for what they suggest of the bands between them."),
    METHOD(lay, "Write the triangles of walks."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_bands)
