/* Walks along pairs of contours: the loops of walking.py that no array operation expresses.
 *
 * A walk goes around the contour below and the contour above of a pair, in as many steps as both
 * have edges. Each step is a triangle: a rise over an edge below, or a run over an edge above.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { CANDIDATES = 8 }; /* vertices of a contour that a walk may begin at */
static const double TIE = 1e-6; /* relatively: choices that differ by less are rounding's */
static const double TIE_OF_SUMS = 1e-9; /* the same of areas added up, whose choices add up too */

/* The arrays of a call, checked. */
typedef struct {
    const double *points;  /* (n, 3): contours, one behind the other */
    const int64_t *first;  /* (rings + 1,): where each contour begins, and where the last ends */
    const int64_t *pairs;  /* (bands, 2): the contours below and above */
    const double *shifts;  /* (bands, 2): by which contours above are taken back */
    int64_t *starts;       /* (bands, 2), out: the vertices at which the walks begin */
    uint8_t *rises;        /* (steps,), out: walk by walk, 1 for a rise and 0 for a run */
    double *measures;      /* (bands, 2), out: area, and flux of (0, 0, z) upward */
    Py_ssize_t bands;
} Work;

/* A contour from the vertex that a walk begins at, and back to it; x and y shifted. */
typedef struct {
    int64_t count;
    double *x, *y, *z;
    double shift[2];
} Path;

static int64_t count_of(const Work *work, int64_t ring)
{
    return work->first[ring + 1] - work->first[ring];
}

/* Choose the nearest pair of a few vertices below and all above, the first of those as near. */
static void choose_start(const Work *work, Py_ssize_t band)
{
    const int64_t *pair = work->pairs + 2 * band;
    const double *low = work->points + 3 * work->first[pair[0]];
    const double *high = work->points + 3 * work->first[pair[1]];
    const int64_t below = count_of(work, pair[0]), above = count_of(work, pair[1]);
    const double height = high[2] - low[2];
    double least = INFINITY;
    for (int candidate = 0; candidate < CANDIDATES; candidate++) {
        const int64_t row = below * candidate / CANDIDATES;
        const double x = low[3 * row] + work->shifts[2 * band];
        const double y = low[3 * row + 1] + work->shifts[2 * band + 1];
        for (int64_t column = 0; column < above; column++) {
            const double aside = high[3 * column] - x, ahead = high[3 * column + 1] - y;
            const double square = aside * aside + ahead * ahead + height * height;
            if (square < (1 - TIE) * least) {
                least = square;
                work->starts[2 * band] = row;
                work->starts[2 * band + 1] = column;
            }
        }
    }
}

/* Lay a contour's vertices out in the order of the walk; `room` takes 3 (count + 1) numbers. */
static Path path_of(const Work *work, Py_ssize_t band, int side, double *room)
{
    const int64_t ring = work->pairs[2 * band + side], start = work->starts[2 * band + side];
    const double *points = work->points + 3 * work->first[ring];
    Path path = {.count = count_of(work, ring), .shift = {0.0, 0.0}};
    path.x = room;
    path.y = path.x + path.count + 1;
    path.z = path.y + path.count + 1;
    if (side) {
        path.shift[0] = work->shifts[2 * band];
        path.shift[1] = work->shifts[2 * band + 1];
    }
    for (int64_t place = 0; place <= path.count; place++) {
        const double *point = points + 3 * ((start + place) % path.count);
        path.x[place] = point[0] - path.shift[0];
        path.y[place] = point[1] - path.shift[1];
        path.z[place] = point[2];
    }
    return path;
}

/* Walk by the shorter of the two diagonals, and rise where they are as long. */
static void walk_greedily(const Path *low, const Path *high, uint8_t *rises)
{
    const double height = high->z[0] - low->z[0];
    int64_t row = 0, column = 0;
    while (row < low->count || column < high->count) {
        int rise = row < low->count;
        if (rise && column < high->count) {
            const double rise_x = low->x[row + 1] - high->x[column];
            const double rise_y = low->y[row + 1] - high->y[column];
            const double run_x = low->x[row] - high->x[column + 1];
            const double run_y = low->y[row] - high->y[column + 1];
            const double run = run_x * run_x + run_y * run_y;
            const double near_tie = TIE * (run + height * height);
            rise = rise_x * rise_x + rise_y * rise_y <= run + near_tie;
        }
        *rises++ = (uint8_t)rise;
        row += rise;
        column += !rise;
    }
}

/* Walk so that the triangles have the least area in total, by dynamic programming; back from the
 * end, rise where that is as good.
 *
 * `least[column]` is the least area up to a row below and a column above, twice; `came` tells, for
 * each row and column, whether by a rise. `over` takes the areas of one row's triangles.
 */
static void walk_least(const Path *low, const Path *high, double *least, double *over,
                       uint8_t *came, uint8_t *rises)
{
    const int64_t rows = low->count, columns = high->count;
    const double height = high->z[0] - low->z[0];
    double *across = over + columns + 1;
    for (int64_t row = 0; row <= rows; row++) {
        const double x = low->x[row], y = low->y[row];
        uint8_t *by_rise = came + row * (columns + 1);
        for (int64_t column = 0; column < columns; column++) {
            const double edge_x = high->x[column + 1] - high->x[column];
            const double edge_y = high->y[column + 1] - high->y[column];
            const double beside = edge_x * (y - high->y[column]) - edge_y * (x - high->x[column]);
            const double upright = height * height * (edge_x * edge_x + edge_y * edge_y);
            across[column] = sqrt(beside * beside + upright);
        }
        if (row == 0) {
            least[0] = 0.0;
            for (int64_t column = 0; column < columns; column++)
                least[column + 1] = least[column] + across[column];
            memset(by_rise, 0, (size_t)columns + 1);
            continue;
        }
        const double edge_x = x - low->x[row - 1], edge_y = y - low->y[row - 1];
        const double upright = height * height * (edge_x * edge_x + edge_y * edge_y);
        for (int64_t column = 0; column <= columns; column++) {
            const double beside = edge_x * (high->y[column] - y) - edge_y * (high->x[column] - x);
            over[column] = least[column] + sqrt(beside * beside + upright);
        }
        least[0] = over[0];
        by_rise[0] = 1;
        for (int64_t column = 1; column <= columns; column++) {
            const double run = least[column - 1] + across[column - 1];
            by_rise[column] = over[column] <= (1 + TIE_OF_SUMS) * run;
            least[column] = over[column] <= run ? over[column] : run;
        }
    }
    int64_t row = rows, column = columns;
    for (int64_t step = rows + columns - 1; step >= 0; step--) {
        const uint8_t rise = came[row * (columns + 1) + column];
        rises[step] = rise;
        row -= rise;
        column -= !rise;
    }
}

/* Tell whether a walk goes around one contour in one go, and so uses an edge across twice. */
static int is_pinched(const uint8_t *rises, int64_t steps)
{
    int64_t falls = 0;
    for (int64_t step = 0; step < steps; step++)
        falls += rises[step] && !rises[step + 1 < steps ? step + 1 : 0];
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

/* Add up the triangles of a walk where the contours really are. */
static void measure(const Path *low, const Path *high, const uint8_t *rises, double *measures)
{
    const double shift_x = high->shift[0], shift_y = high->shift[1];
    double area = 0.0, flux = 0.0;
    int64_t row = 0, column = 0;
    for (int64_t step = 0; step < low->count + high->count; step++) {
        const int rise = rises[step];
        const double x2 = high->x[column] + shift_x - low->x[row];
        const double y2 = high->y[column] + shift_y - low->y[row];
        const double z2 = high->z[column] - low->z[row];
        const double x1 = (rise ? low->x[row + 1] : high->x[column + 1] + shift_x) - low->x[row];
        const double y1 = (rise ? low->y[row + 1] : high->y[column + 1] + shift_y) - low->y[row];
        const double z1 = (rise ? low->z[row + 1] : high->z[column + 1]) - low->z[row];
        const double upward = x1 * y2 - y1 * x2;
        const double side_x = y1 * z2 - z1 * y2, side_y = z1 * x2 - x1 * z2;
        area += sqrt(upward * upward + side_x * side_x + side_y * side_y) / 2;
        flux += (low->z[row] + (z1 + z2) / 3) * upward / 2;
        row += rise;
        column += !rise;
    }
    measures[0] = area;
    measures[1] = flux;
}

/* Walk along all pairs; return whether the memory sufficed. */
static int walk_all(const Work *work, int is_least)
{
    uint8_t *rises = work->rises;
    for (Py_ssize_t band = 0; band < work->bands; band++) {
        const int64_t below = count_of(work, work->pairs[2 * band]);
        const int64_t above = count_of(work, work->pairs[2 * band + 1]);
        const size_t vertices = (size_t)(below + above + 2), row = (size_t)above + 1;
        double *room = malloc((3 * vertices + (is_least ? 3 * row : 0)) * sizeof(double));
        uint8_t *came = is_least ? malloc(((size_t)below + 1) * row) : NULL;
        if (room == NULL || (is_least && came == NULL)) {
            free(room);
            free(came);
            return 0;
        }
        choose_start(work, band);
        const Path low = path_of(work, band, 0, room);
        const Path high = path_of(work, band, 1, room + 3 * (below + 1));
        if (is_least) {
            double *least = room + 3 * vertices;
            walk_least(&low, &high, least, least + row, came, rises);
            if (is_pinched(rises, below + above))
                unpinch(rises, below + above);
        } else {
            walk_greedily(&low, &high, rises);
        }
        measure(&low, &high, rises, work->measures + 2 * band);
        if (is_pinched(rises, below + above))
            work->measures[2 * band] = INFINITY;
        rises += below + above;
        free(room);
        free(came);
    }
    return 1;
}

/* --- arrays from Python ------------------------------------------------------------------- */

enum { POINTS, FIRST, PAIRS, SHIFTS, STARTS, RISES, MEASURES, ARRAYS };

static const struct {
    const char *name;
    char kind; /* d: float64, q: int64, ?: bool */
    int columns; /* 0: one-dimensional */
    int is_out;
} EXPECTED[ARRAYS] = {
    {"points", 'd', 3, 0}, {"first", 'q', 0, 0}, {"pairs", 'q', 2, 0}, {"shifts", 'd', 2, 0},
    {"starts", 'q', 2, 1}, {"rises", '?', 0, 1}, {"measures", 'd', 2, 1},
};

static int is_as_expected(const Py_buffer *view, int which)
{
    const char *format = view->format ? view->format : "B";
    const char kind = EXPECTED[which].kind;
    const int fits = *format == kind || (kind == 'q' && *format == 'l' && view->itemsize == 8);
    const int columns = EXPECTED[which].columns;
    return fits && view->ndim == 1 + (columns > 0) && (!columns || view->shape[1] == columns);
}

/* Check what C must not find out by itself; set an error and return 0 if something is wrong. */
static int are_consistent(const Py_buffer *views, const Work *work)
{
    const Py_ssize_t rings = views[FIRST].shape[0] - 1;
    int good = rings >= 0 && views[SHIFTS].shape[0] == work->bands
               && views[STARTS].shape[0] == work->bands && views[MEASURES].shape[0] == work->bands;
    good = good && (rings < 0 || (work->first[0] >= 0 && work->first[rings] <= views[POINTS].shape[0]));
    for (Py_ssize_t ring = 0; good && ring < rings; ring++)
        good = work->first[ring] < work->first[ring + 1];
    int64_t steps = 0;
    for (Py_ssize_t place = 0; good && place < 2 * work->bands; place++) {
        const int64_t ring = work->pairs[place];
        good = ring >= 0 && ring < rings;
        steps += good ? count_of(work, ring) : 0;
    }
    good = good && steps == views[RISES].shape[0];
    if (!good)
        PyErr_SetString(PyExc_ValueError,
                        "Expected contours with vertices, pairs of them, and arrays that agree");
    return good;
}

static PyObject *walk(PyObject *const *arguments, Py_ssize_t count, int is_least)
{
    Py_buffer views[ARRAYS];
    int got = 0, good = count == ARRAYS;
    if (!good)
        PyErr_Format(PyExc_TypeError, "Expected %d arrays, got %zd", ARRAYS, count);
    for (; good && got < ARRAYS; got++) {
        const int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT;
        if (PyObject_GetBuffer(arguments[got], &views[got],
                               EXPECTED[got].is_out ? flags | PyBUF_WRITABLE : flags)) {
            good = 0;
            break;
        }
        if (!is_as_expected(&views[got], got)) {
            PyErr_Format(PyExc_TypeError, "Expected another kind or shape of %s",
                         EXPECTED[got].name);
            good = 0;
            got++;
            break;
        }
    }
    if (good) {
        const Work work = {views[POINTS].buf, views[FIRST].buf,  views[PAIRS].buf,
                           views[SHIFTS].buf, views[STARTS].buf, views[RISES].buf,
                           views[MEASURES].buf, views[PAIRS].shape[0]};
        good = are_consistent(views, &work);
        if (good) {
            Py_BEGIN_ALLOW_THREADS
            good = walk_all(&work, is_least);
            Py_END_ALLOW_THREADS
            if (!good)
                PyErr_NoMemory();
        }
    }
    while (got > 0)
        PyBuffer_Release(&views[--got]);
    if (!good)
        return NULL;
    Py_RETURN_NONE;
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

static PyMethodDef METHODS[] = {
    {"greedy", (PyCFunction)(void (*)(void))greedy, METH_FASTCALL,
     "Walk by the shorter of the two diagonals."},
    {"least", (PyCFunction)(void (*)(void))least, METH_FASTCALL,
     "Walk so that the triangles have the least area in total."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "_bands", .m_size = 0, .m_methods = METHODS,
};

PyMODINIT_FUNC PyInit__bands(void)
{
    return PyModuleDef_Init(&MODULE);
}
