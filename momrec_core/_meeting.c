/* Where contours of two layers meet: the loops of noding.py that no array operation expresses. */

#include "_bounds.h"
#include "_lists.h"
#include "_module.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

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
    List contacts;
} Contacts;

static Edge edge_of(int64_t group, int64_t number, const double *start, const double *end,
                    double touch)
{
    Edge edge = {.group = group, .number = number};
    double span[2];
    for (int axis = 0; axis < 2; axis++) {
        edge.start[axis] = start[axis];
        edge.end[axis] = end[axis];
        edge.low[axis] = lesser(start[axis], end[axis]) - touch;
        edge.high[axis] = greater(start[axis], end[axis]) + touch;
        span[axis] = end[axis] - start[axis];
    }
    edge.length = greater(sqrt(span[0] * span[0] + span[1] * span[1]), DBL_MIN);
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
                low = lesser(edge->low[axis], low);
                high = greater(edge->high[axis], high);
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
    return lesser(fabs(one), fabs(other)) > touch && (one > 0) != (other > 0);
}

static int add_contact(Contacts *found, const Edge *below, const Edge *above, double below_at,
                       double above_at)
{
    Contact *contact = appended(&found->contacts, sizeof(Contact));
    if (contact == NULL)
        return 0;
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

/* --- Python ------------------------------------------------------------------------------- */

enum { POINTS, FIRST, CHOSEN, GROUPS, IS_ABOVE, ARRAYS };

static const ArrayKind KINDS[ARRAYS] = {
    {"points", 'd', 3, 0}, {"first", 'q', 0, 0}, {"chosen", 'q', 0, 0},
    {"groups", 'q', 0, 0}, {"is_above", '?', 0, 0},
};

static int are_contours(const Py_buffer *views, const Contours *contours)
{
    return are_ends(&views[FIRST], views[POINTS].shape[0], 1)
           && views[GROUPS].shape[0] == contours->count
           && views[IS_ABOVE].shape[0] == contours->count
           && are_within(contours->chosen, contours->count, views[FIRST].shape[0] - 1);
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
    return bytes_of(&found->contacts);
}

static PyObject *contacts(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[ARRAYS];
    const double touch =
        count == ARRAYS + 1 ? PyFloat_AsDouble(arguments[ARRAYS]) : 0.0;
    if (PyErr_Occurred()
        || !get_arrays(arguments, count - 1, KINDS, ARRAYS, views))
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
    release_arrays(views, ARRAYS);
    PyObject *result = result_of(&found, outcome);
    free(found.contacts.items);
    return result;
}

static PyMethodDef METHODS[] = {
    METHOD(contacts,
           "Return where contours below share vertices with those above, touch, or cross them."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_meeting)
