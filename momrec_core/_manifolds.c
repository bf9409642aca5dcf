/* Triangles that crowd around edges, and surfaces of some of their triangles: the loops of
 * manifolds.py that no array operation expresses.
 */

#include "_module.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* A side of a triangle, from the lesser of its vertices. */
typedef struct {
    int64_t to, triangle;
} Spoke;

/* Triangles, some of which may share edges with more than one other. */
typedef struct {
    const int64_t *corners; /* (count, 3) */
    const double *points;   /* (vertices, 3) */
    Py_ssize_t count, sound, vertices;
    uint8_t *is_crowded; /* (count,): whether a triangle has such an edge */
    uint8_t *is_met;     /* (vertices,): whether any but the sound triangles use a vertex */
    int64_t *ends;       /* (vertices + 1,) */
    int64_t *uses;       /* (vertices,) */
} Triangles;

/* Crowded triangles to take with those that are not, and what is taken. */
typedef struct {
    const int64_t *rows; /* (count,) */
    Py_ssize_t count;
    double *points;      /* (vertices, 3), out */
    int64_t *triangles;  /* (taken, 3), out */
} Chosen;

/* Count the sides that any but sound triangles may share by their lesser vertices, or enter them
 * with these; return how many there are.
 */
static int64_t enter_sides(const Triangles *all, Spoke *spokes)
{
    const int64_t *corner = all->corners;
    const uint8_t *const is_met = all->is_met;
    int64_t *const ends = all->ends;
    int64_t sides = 0;
    for (Py_ssize_t triangle = 0; triangle < all->count; triangle++, corner += 3) {
        if (is_met[corner[0]] + is_met[corner[1]] + is_met[corner[2]] < 2)
            continue;
        for (int side = 0; side < 3; side++) {
            const int64_t head = corner[side], tail = corner[side < 2 ? side + 1 : 0];
            const int64_t from = head < tail ? head : tail;
            if (!is_met[head] || !is_met[tail])
                continue;
            sides++;
            if (spokes != NULL)
                spokes[ends[from]++] = (Spoke){head + tail - from, triangle};
            else
                ends[from + 1]++;
        }
    }
    return sides;
}

/* Mark the triangles around edges that more than two share. */
static int mark_crowded(const Triangles *all)
{
    const int64_t *const restrict corners = all->corners;
    int64_t *const restrict uses = all->uses;
    for (int64_t corner = 3 * all->sound; corner < 3 * all->count; corner++)
        all->is_met[corners[corner]] = 1;
    Spoke *spokes = malloc((size_t)enter_sides(all, NULL) * sizeof(Spoke) + 1);
    if (spokes == NULL)
        return 0;
    for (Py_ssize_t vertex = 0; vertex < all->vertices; vertex++)
        all->ends[vertex + 1] += all->ends[vertex];
    enter_sides(all, spokes);
    const Spoke *begin = spokes;
    for (Py_ssize_t vertex = 0; vertex < all->vertices; vertex++) {
        const Spoke *const end = spokes + all->ends[vertex];
        for (const Spoke *spoke = begin; spoke < end; spoke++)
            uses[spoke->to]++;
        for (const Spoke *spoke = begin; spoke < end; spoke++)
            all->is_crowded[spoke->triangle] |= uses[spoke->to] > 2;
        for (; begin < end; begin++)
            uses[begin->to] = 0;
    }
    free(spokes);
    return 1;
}

static int find_crowded(Triangles *all)
{
    memset(all->is_crowded, 0, (size_t)all->count);
    all->is_met = calloc((size_t)all->vertices + 1, 1);
    all->ends = calloc((size_t)all->vertices + 1, sizeof(int64_t));
    all->uses = calloc((size_t)all->vertices + 1, sizeof(int64_t));
    const int fits = all->is_met != NULL && all->ends != NULL && all->uses != NULL
                     && mark_crowded(all);
    free(all->is_met);
    free(all->ends);
    free(all->uses);
    return fits;
}

/* Copy a triangle and mark the vertices that it uses. */
static void copy_triangle(const int64_t *restrict corners, int64_t *restrict copy,
                          int64_t *restrict is_used)
{
    for (int corner = 0; corner < 3; corner++) {
        copy[corner] = corners[corner];
        is_used[corners[corner]] = 1;
    }
}

/* Take the triangles that are not crowded, then some others, and the points that these use; return
 * how many points these are, or -1 where memory doesn't suffice.
 */
static int64_t take_triangles(const Triangles *all, const Chosen *chosen)
{
    int64_t *const restrict numbers = calloc((size_t)all->vertices + 1, sizeof(int64_t));
    if (numbers == NULL)
        return -1;
    int64_t *end = chosen->triangles;
    for (Py_ssize_t triangle = 0; triangle < all->count; triangle++)
        if (!all->is_crowded[triangle]) {
            copy_triangle(all->corners + 3 * triangle, end, numbers);
            end += 3;
        }
    for (Py_ssize_t row = 0; row < chosen->count; row++, end += 3)
        copy_triangle(all->corners + 3 * chosen->rows[row], end, numbers);
    int64_t points = 0;
    for (Py_ssize_t vertex = 0; vertex < all->vertices; vertex++)
        if (numbers[vertex]) {
            memcpy(chosen->points + 3 * points, all->points + 3 * vertex, 3 * sizeof(double));
            numbers[vertex] = points++;
        }
    for (int64_t *restrict corner = chosen->triangles; corner < end; corner++)
        *corner = numbers[*corner];
    free(numbers);
    return points;
}

/* --- Python ------------------------------------------------------------------------------- */

enum { CORNERS, IS_CROWDED, TRIANGLE_ARRAYS };

static const char EXPECTED[] = "Expected triangles of so many vertices, and arrays that agree";

static const ArrayKind TRIANGLE_KINDS[TRIANGLE_ARRAYS] = {
    {"triangles", 'q', 3, 0}, {"is_crowded", '?', 0, 1},
};

static int are_triangles(const Triangles *all)
{
    return all->sound >= 0 && all->sound <= all->count
           && are_within(all->corners, 3 * all->count, all->vertices);
}

static PyObject *crowded(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[TRIANGLE_ARRAYS];
    Triangles all = {0};
    if (count == TRIANGLE_ARRAYS + 2) {
        all.sound = PyLong_AsSsize_t(arguments[TRIANGLE_ARRAYS]);
        all.vertices = PyErr_Occurred() ? 0 : PyLong_AsSsize_t(arguments[TRIANGLE_ARRAYS + 1]);
    }
    if (PyErr_Occurred()
        || !get_arrays(arguments, count - 2, TRIANGLE_KINDS, TRIANGLE_ARRAYS, views))
        return NULL;
    all.corners = views[CORNERS].buf;
    all.count = views[CORNERS].shape[0];
    all.is_crowded = views[IS_CROWDED].buf;
    const int good = views[IS_CROWDED].shape[0] == all.count && are_triangles(&all);
    int fits = 1;
    Py_BEGIN_ALLOW_THREADS
    fits = !good || find_crowded(&all);
    Py_END_ALLOW_THREADS
    return ended(views, TRIANGLE_ARRAYS, good, fits, EXPECTED);
}

enum { IS_LEFT_OUT = TRIANGLE_ARRAYS - 1, ROWS, POINTS, TAKEN_POINTS, TAKEN, TAKEN_ARRAYS };

static const ArrayKind TAKEN_KINDS[TAKEN_ARRAYS] = {
    {"triangles", 'q', 3, 0}, {"is_crowded", '?', 0, 0}, {"rows", 'q', 0, 0},
    {"points", 'd', 3, 0},    {"taken_points", 'd', 3, 1}, {"taken", 'q', 3, 1},
};

/* Tell whether the rows are some, and there is room for as many triangles and points as needed. */
static int are_chosen(const Triangles *all, const Chosen *chosen, const Py_buffer *views)
{
    Py_ssize_t taken = chosen->count;
    if (views[IS_LEFT_OUT].shape[0] != all->count)
        return 0;
    for (Py_ssize_t triangle = 0; triangle < all->count; triangle++)
        taken += !all->is_crowded[triangle];
    return views[TAKEN].shape[0] == taken && views[TAKEN_POINTS].shape[0] == all->vertices
           && are_within(chosen->rows, chosen->count, all->count);
}

static PyObject *take(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[TAKEN_ARRAYS];
    if (!get_arrays(arguments, count, TAKEN_KINDS, TAKEN_ARRAYS, views))
        return NULL;
    const Triangles all = {.corners = views[CORNERS].buf, .count = views[CORNERS].shape[0],
                           .points = views[POINTS].buf, .vertices = views[POINTS].shape[0],
                           .is_crowded = views[IS_LEFT_OUT].buf};
    const Chosen chosen = {.rows = views[ROWS].buf, .count = views[ROWS].shape[0],
                           .points = views[TAKEN_POINTS].buf, .triangles = views[TAKEN].buf};
    const int good = are_triangles(&all) && are_chosen(&all, &chosen, views);
    int64_t points = 0;
    Py_BEGIN_ALLOW_THREADS
    if (good)
        points = take_triangles(&all, &chosen);
    Py_END_ALLOW_THREADS
    PyObject *const none = ended(views, TAKEN_ARRAYS, good, points >= 0, EXPECTED);
    if (none == NULL)
        return NULL;
    Py_DECREF(none);
    return PyLong_FromLongLong(points);
}

static PyMethodDef METHODS[] = {
    METHOD(crowded, "Tell which triangles have an edge that more than two share."),
    METHOD(take, "Take triangles and the points that they use; return how many points."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_manifolds)
