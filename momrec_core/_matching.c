/* Pieces of adjacent layers grouped by what overlaps.
 *
 * Two pieces overlap where they have an area in common: often the middle of what their boxes share
 * lies in both, else they are clipped with each other. Where that is degenerate, a library is asked.
 */

#include "_clipping.h"

/* Columns of the results.
 * A pair: slab, piece below and above, contours of each, number of each one's first in its layer.
 * A knot's member: slab, number of the knot in it, side (0 below, 1 above), piece. */
enum { PAIR = 6, MEMBER = 4 };

/* What decides about overlaps, and how the pieces are kept. */
typedef struct {
    Regions pieces;
    const double *areas; /* of the pieces */
    const Box *boxes;
    const int64_t *starts, *counts; /* (2 slabs,): a layer's first piece, and how many it has */
    Py_ssize_t slabs;
    const int64_t *listed; /* (n, 3): slabs, in order, and pieces of both layers to try there */
    Py_ssize_t listed_count;
    int64_t most_tried; /* pairs of a slab: where there could be more, only those listed are tried */
    double area_ratio, width_ratio, tolerance;
    PyObject *library; /* returns the area that two pieces have in common */
    PyThreadState *thread;
} Task;

/* Two pieces of a slab's layers, numbered within these. */
typedef struct {
    int64_t place[2];
    double common; /* their common area, NaN where it is not known */
    int is_pair;
} Overlap;

/* A piece of one of a slab's layers. */
typedef struct {
    int64_t degree, parent, group;
    int is_paired;
} Node;

typedef struct {
    Room clipping;
    Edges edges;
    Outline outline;
    int64_t laid; /* the piece that the outline is of */
    List overlaps, nodes;
    List pairs, members, shares; /* results */
} Desk;

static int add_row(List *table, const int64_t *row, size_t columns)
{
    int64_t *place = appended(table, columns * sizeof(int64_t));
    if (place != NULL)
        memcpy(place, row, columns * sizeof(int64_t));
    return place != NULL;
}

/* --- areas in common ---------------------------------------------------------------------- */

/* Ask the library for the area that two pieces have in common; return 0 with an error set. */
static int ask_library(Task *task, const int64_t pieces[2], double *area)
{
    PyEval_RestoreThread(task->thread);
    PyObject *answer = PyObject_CallFunction(task->library, "LL", (long long)pieces[0],
                                             (long long)pieces[1]);
    *area = answer == NULL ? -1.0 : PyFloat_AsDouble(answer);
    Py_XDECREF(answer);
    const int is_good = !PyErr_Occurred();
    task->thread = PyEval_SaveThread();
    return is_good;
}

/* Lay a piece out as the outline that others are clipped with, unless it is. */
static int lay_outline(const Task *task, Desk *desk, int64_t piece)
{
    if (desk->laid == piece)
        return 1;
    desk->laid = -1;
    if (!lay_out(&desk->outline.edges, desk->outline.memory, &task->pieces, piece)
        || !enter_edges(&desk->outline))
        return 0;
    desk->laid = piece;
    return 1;
}

/* Measure the area that two pieces have in common; return 0 if memory or the library fails. */
static int measure_common(Task *task, Desk *desk, const int64_t pieces[2], double *area)
{
    static const double NOWHERE[2] = {0.0, 0.0};
    Room *room = &desk->clipping;
    room->points.count = room->rings.count = 0;
    if (!lay_out(&desk->edges, room->memory, &task->pieces, pieces[0])
        || !lay_outline(task, desk, pieces[1]) || !add_end(&room->rings, 0))
        return 0;
    Side sides[2] = {{&desk->edges, 1.0, NOWHERE, NULL}, {&desk->outline.edges, 1.0, NOWHERE, NULL}};
    const Outcome outcome = intersect(room, sides, &desk->outline, task->tolerance);
    if (outcome == DOUBTFUL)
        return ask_library(task, pieces, area);
    if (outcome == NO_MEMORY)
        return 0;
    const int64_t all[2] = {0, (int64_t)room->rings.count - 1};
    const Regions common = {room->points.items, room->rings.items, all, 1};
    Box box;
    measure_region(&common, 0, area, &box);
    return 1;
}

/* --- overlaps ----------------------------------------------------------------------------- */

/* Tell whether boxes have an area in common. */
static int boxes_overlap(const Box *one, const Box *other)
{
    return (one->low[0] < other->high[0]) & (other->low[0] < one->high[0])
           & (one->low[1] < other->high[1]) & (other->low[1] < one->high[1]);
}

/* Return the number, among all, of a piece of a slab's lower or upper layer. */
static int64_t piece_at(const Task *task, Py_ssize_t slab, int side, int64_t place)
{
    return task->starts[2 * slab + side] + place;
}

/* Add two pieces to the overlaps if they have an area in common. */
static int add_overlap(Task *task, Desk *desk, Py_ssize_t slab, int64_t low, int64_t high)
{
    const int64_t pieces[2] = {piece_at(task, slab, 0, low), piece_at(task, slab, 1, high)};
    const Box *one = &task->boxes[pieces[0]], *other = &task->boxes[pieces[1]];
    if (!boxes_overlap(one, other))
        return 1;
    double middle[2], common = NAN;
    for (int axis = 0; axis < 2; axis++)
        middle[axis] = (greater(one->low[axis], other->low[axis])
                        + lesser(one->high[axis], other->high[axis])) / 2;
    if (!region_holds(&task->pieces, pieces[0], middle)
        || !region_holds(&task->pieces, pieces[1], middle)) {
        if (!measure_common(task, desk, pieces, &common))
            return 0;
        if (!(common > 0))
            return 1;
    }
    Overlap *overlap = appended(&desk->overlaps, sizeof(Overlap));
    if (overlap != NULL)
        *overlap = (Overlap){{low, high}, common, 0};
    return overlap != NULL;
}

/* Find the overlaps of a slab; advance in the list of pairs to try. */
static int find_overlaps(Task *task, Desk *desk, Py_ssize_t slab, Py_ssize_t *listed)
{
    const int64_t *counts = task->counts + 2 * slab;
    desk->overlaps.count = 0;
    if (counts[1] == 0 || counts[0] <= task->most_tried / counts[1]) {
        for (int64_t low = 0; low < counts[0]; low++)
            for (int64_t high = 0; high < counts[1]; high++)
                if (!add_overlap(task, desk, slab, low, high))
                    return 0;
    }
    for (; *listed < task->listed_count && task->listed[3 * *listed] == slab; ++*listed)
        if (!add_overlap(task, desk, slab, task->listed[3 * *listed + 1],
                         task->listed[3 * *listed + 2]))
            return 0;
    return 1;
}

/* --- pairs -------------------------------------------------------------------------------- */

/* Tell whether two pieces may be one and the same a little higher. */
static int are_images(const Task *task, const int64_t pieces[2])
{
    const double ratio = task->areas[pieces[0]] / task->areas[pieces[1]];
    int are_similar = ratio > task->area_ratio && ratio < 1 / task->area_ratio;
    for (int axis = 0; axis < 2; axis++) {
        const double one = task->boxes[pieces[0]].high[axis] - task->boxes[pieces[0]].low[axis];
        const double other = task->boxes[pieces[1]].high[axis] - task->boxes[pieces[1]].low[axis];
        are_similar &= lesser(one, other) > task->width_ratio * greater(one, other);
    }
    return are_similar;
}

/* Number a slab's pieces as nodes: those below, then those above. */
static Node *count_degrees(const Task *task, Desk *desk, Py_ssize_t slab)
{
    const int64_t *counts = task->counts + 2 * slab;
    Node *nodes = reserved(&desk->nodes, (size_t)(counts[0] + counts[1]), sizeof(Node));
    const Overlap *overlaps = desk->overlaps.items;
    if (nodes == NULL)
        return NULL;
    for (int64_t node = 0; node < counts[0] + counts[1]; node++)
        nodes[node] = (Node){0, node, 0, 0};
    for (size_t place = 0; place < desk->overlaps.count; place++) {
        nodes[overlaps[place].place[0]].degree++;
        nodes[counts[0] + overlaps[place].place[1]].degree++;
    }
    return nodes;
}

/* Add a slab's pairs: pieces alike that overlap nothing else, with as many contours. */
static int add_pairs(const Task *task, Desk *desk, Py_ssize_t slab, Node *nodes)
{
    Overlap *overlap = desk->overlaps.items;
    const int64_t *first = task->pieces.regions;
    for (size_t left = desk->overlaps.count; left > 0; left--, overlap++) {
        Node *const ends[2] = {nodes + overlap->place[0],
                               nodes + task->counts[2 * slab] + overlap->place[1]};
        const int64_t pieces[2] = {piece_at(task, slab, 0, overlap->place[0]),
                                   piece_at(task, slab, 1, overlap->place[1])};
        const int64_t contours = first[pieces[0] + 1] - first[pieces[0]];
        if (ends[0]->degree != 1 || ends[1]->degree != 1 || !are_images(task, pieces)
            || first[pieces[1] + 1] - first[pieces[1]] != contours)
            continue;
        const int64_t row[PAIR] = {slab, overlap->place[0], overlap->place[1], contours,
                                   first[pieces[0]] - first[piece_at(task, slab, 0, 0)],
                                   first[pieces[1]] - first[piece_at(task, slab, 1, 0)]};
        if (!add_row(&desk->pairs, row, PAIR))
            return 0;
        overlap->is_pair = ends[0]->is_paired = ends[1]->is_paired = 1;
    }
    return 1;
}

/* --- knots -------------------------------------------------------------------------------- */

static int64_t root_of(Node *nodes, int64_t node)
{
    while (nodes[node].parent != node)
        node = nodes[node].parent = nodes[nodes[node].parent].parent;
    return node;
}

/* Connect the pieces that overlap without being pairs; add up what they have in common. */
static int connect(Task *task, Desk *desk, Py_ssize_t slab, Node *nodes, double *common)
{
    for (size_t place = 0; place < desk->overlaps.count; place++) {
        Overlap *overlap = (Overlap *)desk->overlaps.items + place;
        if (overlap->is_pair)
            continue;
        const int64_t one = root_of(nodes, overlap->place[0]);
        const int64_t other = root_of(nodes, task->counts[2 * slab] + overlap->place[1]);
        nodes[one > other ? one : other].parent = one > other ? other : one;
        const int64_t pieces[2] = {piece_at(task, slab, 0, overlap->place[0]),
                                   piece_at(task, slab, 1, overlap->place[1])};
        if (isnan(overlap->common) && !measure_common(task, desk, pieces, &overlap->common))
            return 0;
        *common += overlap->common;
    }
    return 1;
}

/* Add the pieces that are in no pair, each with the number of its knot in the slab. */
static int add_members(const Task *task, Desk *desk, Py_ssize_t slab, Node *nodes, double *areas)
{
    const int64_t *counts = task->counts + 2 * slab;
    int64_t groups = 0;
    for (int64_t node = 0; node < counts[0] + counts[1]; node++) {
        if (nodes[node].is_paired)
            continue;
        const int64_t root = root_of(nodes, node); /* the first of all that are connected */
        nodes[node].group = root == node ? groups++ : nodes[root].group;
        const int side = node >= counts[0];
        const int64_t place = side ? node - counts[0] : node;
        if (!add_row(&desk->members, (int64_t[MEMBER]){slab, nodes[node].group, side, place}, MEMBER))
            return 0;
        areas[side] += task->areas[piece_at(task, slab, side, place)];
    }
    return 1;
}

/* Match the layers of all slabs; return 0 if memory, or the library with an error set, fails. */
static int match_all(Task *task, Desk *desk)
{
    Py_ssize_t listed = 0;
    for (Py_ssize_t slab = 0; slab < task->slabs; slab++) {
        double shares[3] = {0.0, 0.0, 0.0};
        Node *nodes = find_overlaps(task, desk, slab, &listed) ? count_degrees(task, desk, slab)
                                                               : NULL;
        if (nodes == NULL || !add_pairs(task, desk, slab, nodes)
            || !connect(task, desk, slab, nodes, &shares[2])
            || !add_members(task, desk, slab, nodes, shares))
            return 0;
        double *result = appended(&desk->shares, sizeof(shares));
        if (result == NULL)
            return 0;
        memcpy(result, shares, sizeof(shares));
    }
    return 1;
}

static void clear_desk(Desk *desk)
{
    List *const lists[] = {&desk->outline.memory[0], &desk->outline.memory[1],
                           &desk->outline.memory[2], &desk->outline.cells, &desk->outline.entries,
                           &desk->overlaps, &desk->nodes, &desk->pairs, &desk->members,
                           &desk->shares};
    free_room(&desk->clipping);
    for (size_t place = 0; place < sizeof(lists) / sizeof(*lists); place++)
        free(lists[place]->items);
}

/* --- Python ------------------------------------------------------------------------------- */

enum { POINTS, RINGS, PIECES, AREAS, BOXES, STARTS, COUNTS, LISTED, ARRAYS };
enum { LIBRARY = ARRAYS, MOST_TRIED, AREA_RATIO, WIDTH_RATIO, TOLERANCE, ARGUMENTS };

static const ArrayKind KINDS[ARRAYS] = {
    {"points", 'd', 2, 0}, {"rings", 'q', 0, 0},  {"pieces", 'q', 0, 0}, {"areas", 'd', 0, 0},
    {"boxes", 'd', 4, 0},  {"starts", 'q', 0, 0}, {"counts", 'q', 0, 0}, {"listed", 'q', 3, 0},
};

/* Tell whether layers are among the pieces, and what is listed among the layers, in order. */
static int are_layers(const Task *task)
{
    for (Py_ssize_t side = 0; side < 2 * task->slabs; side++)
        if (task->starts[side] < 0 || task->starts[side] > task->pieces.count
            || task->counts[side] < 0
            || task->counts[side] > task->pieces.count - task->starts[side])
            return 0;
    for (Py_ssize_t place = 0; place < task->listed_count; place++) {
        const int64_t *row = task->listed + 3 * place;
        const int64_t least = place > 0 ? row[-3] : 0;
        if (row[0] < least || row[0] >= task->slabs || row[1] < 0 || row[2] < 0
            || row[1] >= task->counts[2 * row[0]] || row[2] >= task->counts[2 * row[0] + 1])
            return 0;
    }
    return 1;
}

static int is_consistent(const Py_buffer *views, Task *task)
{
    task->areas = views[AREAS].buf;
    task->boxes = views[BOXES].buf;
    task->starts = views[STARTS].buf;
    task->counts = views[COUNTS].buf;
    task->slabs = views[STARTS].shape[0] / 2;
    task->listed = views[LISTED].buf;
    task->listed_count = views[LISTED].shape[0];
    return are_regions(views, &task->pieces) && views[AREAS].shape[0] == task->pieces.count
           && views[BOXES].shape[0] == task->pieces.count
           && views[STARTS].shape[0] == 2 * task->slabs
           && views[COUNTS].shape[0] == 2 * task->slabs && task->most_tried >= 0
           && task->tolerance >= 0 && task->tolerance <= MOST && are_layers(task);
}

static PyObject *match(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[ARRAYS];
    if (count != ARGUMENTS)
        return PyErr_Format(PyExc_TypeError, "Expected %d arguments, got %zd", ARGUMENTS, count);
    Task task = {.library = arguments[LIBRARY],
                 .most_tried = PyLong_AsLongLong(arguments[MOST_TRIED]),
                 .area_ratio = PyFloat_AsDouble(arguments[AREA_RATIO]),
                 .width_ratio = PyFloat_AsDouble(arguments[WIDTH_RATIO]),
                 .tolerance = PyFloat_AsDouble(arguments[TOLERANCE])};
    if (PyErr_Occurred() || !get_arrays(arguments, ARRAYS, KINDS, ARRAYS, views))
        return NULL;
    PyObject *result = NULL;
    if (is_consistent(views, &task)) {
        Desk desk = {.laid = -1};
        task.thread = PyEval_SaveThread();
        const int is_good = match_all(&task, &desk);
        PyEval_RestoreThread(task.thread);
        if (is_good)
            result = Py_BuildValue("NNN", bytes_of(&desk.pairs), bytes_of(&desk.members),
                                   bytes_of(&desk.shares));
        else if (!PyErr_Occurred())
            PyErr_NoMemory();
        clear_desk(&desk);
    } else {
        reject();
    }
    release_arrays(views, ARRAYS);
    return result;
}

static PyMethodDef METHODS[] = {
    {"match", (PyCFunction)(void (*)(void))match, METH_FASTCALL,
     "Pair the pieces of adjacent layers that overlap nothing else, and group the others."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "_matching", .m_size = 0, .m_methods = METHODS,
};

PyMODINIT_FUNC PyInit__matching(void)
{
    return PyModuleDef_Init(&MODULE);
}
