/* Where contours of two layers meet, and where triangles crowd around an edge: the loops of
 * noding.py and manifolds.py that no array operation expresses.
 */

#include "_arrays.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* --- contacts of edges -------------------------------------------------------------------- */

/* An edge of a closed ring; its box is larger by as much as touching edges may be apart. */
typedef struct {
    int64_t group, number;
    double start[2], end[2], tangent[2], length;
    double low[2], high[2];
} Edge;

/* Edges of one layer by their groups, and in each by where their boxes begin along an axis. */
typedef struct {
    Edge *edges;
    Py_ssize_t count;
} Side;

typedef struct {
    int64_t group;
    int64_t edges[2]; /* below and above */
    double at[2];     /* where on them, 0 to 1 */
    double point[2];
} Contact;

/* Contours one behind the other, and those of them that may meet. */
typedef struct {
    const double *points;   /* (n, 3) */
    const int64_t *first;   /* (rings + 1,): where each begins, and where the last ends */
    const int64_t *chosen;  /* (count,) */
    const int64_t *groups;  /* (count,) */
    const uint8_t *is_above; /* (count,): of which layer each is */
    Py_ssize_t count;
} Contours;

typedef enum { DONE, NO_NUMBERS, NO_MEMORY } Outcome;

/* What edges have in common so far. */
typedef struct {
    double touch; /* vertices that are this near to each other or to an edge count as on it */
    int axis;     /* that the edges are sorted along */
    Contact *items;
    size_t count, room;
} Contacts;

static Edge edge_of(int64_t group, int64_t number, const double *start, const double *end,
                    double touch)
{
    Edge edge = {.group = group, .number = number};
    double span[2];
    for (int axis = 0; axis < 2; axis++) {
        edge.start[axis] = start[axis];
        edge.end[axis] = end[axis];
        edge.low[axis] = (start[axis] < end[axis] ? start[axis] : end[axis]) - touch;
        edge.high[axis] = (start[axis] < end[axis] ? end[axis] : start[axis]) + touch;
        span[axis] = end[axis] - start[axis];
    }
    edge.length = fmax(sqrt(span[0] * span[0] + span[1] * span[1]), DBL_MIN);
    for (int axis = 0; axis < 2; axis++)
        edge.tangent[axis] = span[axis] / edge.length;
    return edge;
}

/* Return the axis along which boxes are narrower, compared with the extent of all. */
static int narrow_axis(const Side *sides)
{
    double shares[2];
    for (int axis = 0; axis < 2; axis++) {
        double widths = 0.0, low = INFINITY, high = -INFINITY;
        for (int which = 0; which < 2; which++) {
            for (Py_ssize_t place = 0; place < sides[which].count; place++) {
                const Edge *edge = sides[which].edges + place;
                widths += edge->high[axis] - edge->low[axis];
                low = fmin(low, edge->low[axis]);
                high = fmax(high, edge->high[axis]);
            }
        }
        shares[axis] = widths / (high - low);
    }
    return shares[1] < shares[0];
}

static int compared(const Edge *one, const Edge *other, int axis)
{
    if (one->group != other->group)
        return one->group < other->group ? -1 : 1;
    if (one->low[axis] != other->low[axis])
        return one->low[axis] < other->low[axis] ? -1 : 1;
    return one->number < other->number ? -1 : one->number > other->number;
}

static int compared_in_x(const void *one, const void *other) { return compared(one, other, 0); }
static int compared_in_y(const void *one, const void *other) { return compared(one, other, 1); }

/* Return the distance of a point from an edge's line, positive on its left. */
static double beside(const Edge *edge, const double *point)
{
    return edge->tangent[0] * (point[1] - edge->start[1])
           - edge->tangent[1] * (point[0] - edge->start[0]);
}

/* Return where along an edge a point lies, 0 to 1; NAN where not inside it. */
static double place_inside(const Edge *edge, const double *point, double touch)
{
    const double along = (point[0] - edge->start[0]) * edge->tangent[0]
                         + (point[1] - edge->start[1]) * edge->tangent[1];
    return along > touch && along < edge->length - touch ? along / edge->length : NAN;
}

/* Tell whether signed distances from a line are clearly on either side of it. */
static int are_opposite(double one, double other, double touch)
{
    return fmin(fabs(one), fabs(other)) > touch && (one > 0) != (other > 0);
}

static int add_contact(Contacts *found, const Edge *below, const Edge *above, double below_at,
                       double above_at)
{
    if (found->count == found->room) {
        const size_t room = 2 * found->room + 64;
        Contact *items = realloc(found->items, room * sizeof(Contact));
        if (items == NULL)
            return 0;
        found->items = items;
        found->room = room;
    }
    Contact *contact = found->items + found->count++;
    *contact = (Contact){
        below->group, {below->number, above->number}, {below_at, above_at}, {0.0, 0.0}};
    for (int axis = 0; axis < 2; axis++)
        contact->point[axis] =
            above_at == 0 && below_at > 0
                ? above->start[axis]
                : below->start[axis] + below_at * (below->end[axis] - below->start[axis]);
    return 1;
}

/* Add what two edges have in common: their first vertices, one on the other edge, a crossing. */
static int meet(Contacts *found, const Edge *below, const Edge *above)
{
    const double touch = found->touch;
    const double apart[2] = {below->start[0] - above->start[0], below->start[1] - above->start[1]};
    const double start = beside(above, below->start), end = beside(above, below->end);
    const double begin = beside(below, above->start), stop = beside(below, above->end);
    const double at = fabs(begin) <= touch ? place_inside(below, above->start, touch) : NAN;
    const double above_at = fabs(start) <= touch ? place_inside(above, below->start, touch) : NAN;
    int fits = 1;
    if (apart[0] * apart[0] + apart[1] * apart[1] <= touch * touch)
        fits = add_contact(found, below, above, 0.0, 0.0);
    if (!isnan(above_at))
        fits = fits && add_contact(found, below, above, 0.0, above_at);
    if (!isnan(at))
        fits = fits && add_contact(found, below, above, at, 0.0);
    if (are_opposite(start, end, touch) && are_opposite(begin, stop, touch))
        fits = fits && add_contact(found, below, above, start / (start - end),
                                   begin / (begin - stop));
    return fits;
}

/* Add the contacts of edges with those of the other side whose boxes begin within theirs.
 *
 * Boxes that begin together are taken with the edges below alone.
 */
static int sweep(Contacts *found, const Side *sides, int which)
{
    const int axis = found->axis, across = 1 - axis;
    const Edge *other = sides[!which].edges, *const last = other + sides[!which].count;
    for (Py_ssize_t place = 0; place < sides[which].count; place++) {
        const Edge *edge = sides[which].edges + place;
        while (other < last
               && (other->group < edge->group
                   || (other->group == edge->group
                       && (which ? other->low[axis] <= edge->low[axis]
                                 : other->low[axis] < edge->low[axis]))))
            other++;
        for (const Edge *near = other; near < last && near->group == edge->group
                                       && near->low[axis] <= edge->high[axis]; near++)
            if (near->low[across] <= edge->high[across] && edge->low[across] <= near->high[across]
                && !(which ? meet(found, near, edge) : meet(found, edge, near)))
                return 0;
    }
    return 1;
}

/* Lay out the edges of the contours of one layer, as far as their coordinates are numbers. */
static Outcome lay_out(const Contours *contours, int which, double touch, Side *side)
{
    size_t count = 0;
    for (Py_ssize_t place = 0; place < contours->count; place++)
        if ((contours->is_above[place] != 0) == which)
            count += (size_t)(contours->first[contours->chosen[place] + 1]
                              - contours->first[contours->chosen[place]]);
    side->edges = malloc(count * sizeof(Edge) + 1);
    if (side->edges == NULL)
        return NO_MEMORY;
    for (Py_ssize_t place = 0; place < contours->count; place++) {
        const int64_t *ends = contours->first + contours->chosen[place];
        for (int64_t start = ends[0];
             start < ends[1] && (contours->is_above[place] != 0) == which; start++) {
            const double *point = contours->points + 3 * start;
            const int64_t end = start + 1 < ends[1] ? start + 1 : ends[0];
            if (!isfinite(point[0]) || !isfinite(point[1]))
                return NO_NUMBERS;
            side->edges[side->count++] = edge_of(contours->groups[place], start, point,
                                                 contours->points + 3 * end, touch);
        }
    }
    return DONE;
}

static Outcome find_contacts(const Contours *contours, Contacts *found)
{
    Side sides[2] = {{NULL, 0}, {NULL, 0}};
    Outcome outcome = lay_out(contours, 0, found->touch, &sides[0]);
    if (outcome == DONE)
        outcome = lay_out(contours, 1, found->touch, &sides[1]);
    if (outcome == DONE) {
        found->axis = narrow_axis(sides);
        for (int which = 0; which < 2; which++)
            qsort(sides[which].edges, (size_t)sides[which].count, sizeof(Edge),
                  found->axis ? compared_in_y : compared_in_x);
        if (!sweep(found, sides, 0) || !sweep(found, sides, 1))
            outcome = NO_MEMORY;
    }
    free(sides[0].edges);
    free(sides[1].edges);
    return outcome;
}

/* --- crowded edges ------------------------------------------------------------------------ */

/* A side of a triangle, from the lesser of its vertices. */
typedef struct {
    int64_t to, triangle;
} Spoke;

/* Triangles, some of which may share edges with more than one other. */
typedef struct {
    const int64_t *corners; /* (count, 3) */
    Py_ssize_t count, sound, vertices;
    uint8_t *is_crowded; /* (count,), out: whether a triangle has such an edge */
    uint8_t *is_met;     /* (vertices,): whether any but the sound triangles use a vertex */
    int64_t *ends;       /* (vertices + 1,) */
    int64_t *uses;       /* (vertices,) */
} Triangles;

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

/* Take some triangles, their vertices numbered anew, without those that none of them uses. */
static int take_triangles(const Triangles *all, const int64_t *restrict rows, Py_ssize_t count,
                          uint8_t *restrict is_used, int64_t *restrict taken)
{
    const int64_t *const restrict corners = all->corners;
    int64_t *const restrict numbers = malloc((size_t)all->vertices * sizeof(int64_t) + 1);
    if (numbers == NULL)
        return 0;
    memset(is_used, 0, (size_t)all->vertices);
    for (Py_ssize_t row = 0; row < count; row++)
        for (int corner = 0; corner < 3; corner++)
            is_used[corners[3 * rows[row] + corner]] = 1;
    int64_t number = 0;
    for (Py_ssize_t vertex = 0; vertex < all->vertices; vertex++) {
        numbers[vertex] = number;
        number += is_used[vertex];
    }
    for (Py_ssize_t row = 0; row < count; row++)
        for (int corner = 0; corner < 3; corner++)
            taken[3 * row + corner] = numbers[corners[3 * rows[row] + corner]];
    free(numbers);
    return 1;
}

/* --- Python ------------------------------------------------------------------------------- */

enum { POINTS, FIRST, CHOSEN, GROUPS, IS_ABOVE, CONTOUR_ARRAYS };

static const ArrayKind CONTOUR_KINDS[CONTOUR_ARRAYS] = {
    {"points", 'd', 3, 0}, {"first", 'q', 0, 0}, {"chosen", 'q', 0, 0},
    {"groups", 'q', 0, 0}, {"is_above", '?', 0, 0},
};

static int are_contours(const Py_buffer *views, const Contours *contours)
{
    int fit = are_ends(&views[FIRST], views[POINTS].shape[0], 1)
              && views[GROUPS].shape[0] == contours->count
              && views[IS_ABOVE].shape[0] == contours->count;
    for (Py_ssize_t place = 0; place < contours->count; place++)
        fit = fit && contours->chosen[place] >= 0
              && contours->chosen[place] < views[FIRST].shape[0] - 1;
    return fit;
}

/* Return the contacts' bytes, or raise what was wrong. */
static PyObject *result_of(const Contacts *found, Outcome outcome)
{
    if (outcome == NO_NUMBERS)
        return PyErr_Format(PyExc_ValueError,
                            "Expected contours with vertices at finite numbers, and a group and "
                            "a layer of each that is chosen");
    if (outcome == NO_MEMORY)
        return PyErr_NoMemory();
    return PyBytes_FromStringAndSize((const char *)found->items,
                                     (Py_ssize_t)(found->count * sizeof(Contact)));
}

static PyObject *contacts(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[CONTOUR_ARRAYS];
    const double touch =
        count == CONTOUR_ARRAYS + 1 ? PyFloat_AsDouble(arguments[CONTOUR_ARRAYS]) : 0.0;
    if (PyErr_Occurred()
        || !get_arrays(arguments, count - 1, CONTOUR_KINDS, CONTOUR_ARRAYS, views))
        return NULL;
    const Contours contours = {views[POINTS].buf, views[FIRST].buf,    views[CHOSEN].buf,
                               views[GROUPS].buf, views[IS_ABOVE].buf, views[CHOSEN].shape[0]};
    Contacts found = {.touch = touch};
    Outcome outcome = NO_NUMBERS;
    if (isfinite(touch) && are_contours(views, &contours)) {
        Py_BEGIN_ALLOW_THREADS
        outcome = find_contacts(&contours, &found);
        Py_END_ALLOW_THREADS
    }
    release_arrays(views, CONTOUR_ARRAYS);
    PyObject *result = result_of(&found, outcome);
    free(found.items);
    return result;
}

enum { CORNERS, IS_CROWDED, TRIANGLE_ARRAYS };

static const ArrayKind TRIANGLE_KINDS[TRIANGLE_ARRAYS] = {
    {"triangles", 'q', 3, 0}, {"is_crowded", '?', 0, 1},
};

static int are_triangles(const Triangles *all)
{
    int fit = all->sound >= 0 && all->sound <= all->count;
    for (int64_t corner = 0; corner < 3 * all->count; corner++)
        fit &= all->corners[corner] >= 0 && all->corners[corner] < all->vertices;
    return fit;
}

/* End a call: release the arrays, and return None or raise what was wrong. */
static PyObject *ended(Py_buffer *views, int count, int is_consistent, int fits)
{
    release_arrays(views, count);
    if (!is_consistent)
        return PyErr_Format(PyExc_ValueError,
                            "Expected triangles of so many vertices, and arrays that agree");
    if (!fits)
        return PyErr_NoMemory();
    Py_RETURN_NONE;
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
    if (PyErr_Occurred() || !get_arrays(arguments, count - 2, TRIANGLE_KINDS, TRIANGLE_ARRAYS, views))
        return NULL;
    all.corners = views[CORNERS].buf;
    all.count = views[CORNERS].shape[0];
    all.is_crowded = views[IS_CROWDED].buf;
    const int good = views[IS_CROWDED].shape[0] == all.count && are_triangles(&all);
    int fits = 1;
    Py_BEGIN_ALLOW_THREADS
    fits = !good || find_crowded(&all);
    Py_END_ALLOW_THREADS
    return ended(views, TRIANGLE_ARRAYS, good, fits);
}

enum { ROWS = TRIANGLE_ARRAYS - 1, IS_USED, TAKEN, TAKEN_ARRAYS };

static const ArrayKind TAKEN_KINDS[TAKEN_ARRAYS] = {
    {"triangles", 'q', 3, 0}, {"rows", 'q', 0, 0}, {"is_used", '?', 0, 1}, {"taken", 'q', 3, 1},
};

static PyObject *take(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[TAKEN_ARRAYS];
    if (!get_arrays(arguments, count, TAKEN_KINDS, TAKEN_ARRAYS, views))
        return NULL;
    const Triangles all = {.corners = views[CORNERS].buf, .count = views[CORNERS].shape[0],
                           .vertices = views[IS_USED].shape[0]};
    const int64_t *rows = views[ROWS].buf;
    const Py_ssize_t chosen = views[ROWS].shape[0];
    int good = are_triangles(&all) && views[TAKEN].shape[0] == chosen, fits = 1;
    for (Py_ssize_t row = 0; row < chosen; row++)
        good = good && rows[row] >= 0 && rows[row] < all.count;
    Py_BEGIN_ALLOW_THREADS
    fits = !good || take_triangles(&all, rows, chosen, views[IS_USED].buf, views[TAKEN].buf);
    Py_END_ALLOW_THREADS
    return ended(views, TAKEN_ARRAYS, good, fits);
}

static PyMethodDef METHODS[] = {
    {"contacts", (PyCFunction)(void (*)(void))contacts, METH_FASTCALL,
     "Return where contours below share vertices with those above, touch, or cross them."},
    {"crowded", (PyCFunction)(void (*)(void))crowded, METH_FASTCALL,
     "Tell which triangles have an edge that more than two share."},
    {"take", (PyCFunction)(void (*)(void))take, METH_FASTCALL,
     "Take some triangles, their vertices numbered anew, without those that none of them uses."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "_meeting", .m_size = 0, .m_methods = METHODS,
};

PyMODINIT_FUNC PyInit__meeting(void)
{
    return PyModuleDef_Init(&MODULE);
}
