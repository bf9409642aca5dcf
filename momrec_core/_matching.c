/* Pieces of adjacent layers grouped by what overlaps.
 *
 * Two pieces overlap where they have an area in common: often the middle of what their boxes share
 * lies in both, else they are clipped with each other, or where that is degenerate by a library.
 */

#include "_clipping.h"
#include "_module.h"

/* Columns of the results.
 * A pair: slab, piece below and above, number of each one's first contour in its layer, contours.
 * A knot's member: slab, least of the knot's nodes, side (0 below, 1 above), piece.
 * A piece that is alone: slab, side, piece. */
enum { PAIR = 6, MEMBER = 4, ALONE = 3 };

/* The pieces of several layers. */
typedef struct {
    Regions pieces;
    const double *areas;
    const Box *boxes;
} Batch;

/* A layer: so many of a batch's pieces from one on. */
typedef struct {
    int64_t batch, first, count;
} Layer;

typedef struct {
    const Batch *batch;
    int64_t number; /* in the batch */
} Piece;

/* What is to be matched, and what decides about it. */
typedef struct {
    Batch *batches;
    Py_ssize_t batch_count;
    const Layer *layers; /* (2 slabs,): below and above each */
    Py_ssize_t slabs;
    const int64_t *listed; /* (n, 3): slabs, in order, and pieces of both layers to try there */
    Py_ssize_t listed_count;
    int64_t most_tried; /* pairs of a slab: of more, only those listed are tried */
    double area_ratio, width_ratio, tolerance;
    PyObject *library; /* returns the area in common of a slab's pieces below and above */
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
    int64_t degree, parent;
    int is_paired;
} Node;

typedef struct {
    Room clipping;
    Edges edges;
    Outline outline;
    Piece laid; /* that the outline is of; of no batch if of none */
    List overlaps, nodes;
    List pairs, members, alone, shares; /* results */
} Desk;

static int add_row(List *table, const int64_t *row, size_t columns)
{
    int64_t *place = appended(table, columns * sizeof(int64_t));
    if (place != NULL)
        memcpy(place, row, columns * sizeof(int64_t));
    return place != NULL;
}

/* --- areas in common ---------------------------------------------------------------------- */

/* Return a piece of a slab's lower or upper layer. */
static Piece piece_at(const Task *task, Py_ssize_t slab, int side, int64_t place)
{
    const Layer *layer = &task->layers[2 * slab + side];
    return (Piece){&task->batches[layer->batch], layer->first + place};
}

/* Ask the library for the area that two pieces have in common; return 0 with an error set. */
static int ask_library(Task *task, Py_ssize_t slab, const int64_t places[2], double *area)
{
    PyEval_RestoreThread(task->thread);
    PyObject *answer = PyObject_CallFunction(task->library, "nLL", slab, (long long)places[0],
                                             (long long)places[1]);
    *area = answer == NULL ? -1.0 : PyFloat_AsDouble(answer);
    Py_XDECREF(answer);
    const int is_good = !PyErr_Occurred();
    task->thread = PyEval_SaveThread();
    return is_good;
}

/* Lay a piece out as the outline that others are clipped with, unless it is. */
static int lay_outline(Desk *desk, Piece piece)
{
    if (desk->laid.batch == piece.batch && desk->laid.number == piece.number)
        return 1;
    desk->laid.batch = NULL;
    if (!lay_out(&desk->outline.edges, desk->outline.memory, &piece.batch->pieces, piece.number)
        || !enter_edges(&desk->outline))
        return 0;
    desk->laid = piece;
    return 1;
}

/* Measure the area that two pieces have in common; return 0 if memory or the library fails. */
static int measure_common(Task *task, Desk *desk, Py_ssize_t slab, const int64_t places[2],
                          double *area)
{
    const Piece low = piece_at(task, slab, 0, places[0]), high = piece_at(task, slab, 1, places[1]);
    Room *room = &desk->clipping;
    room->points.count = room->rings.count = 0;
    if (!lay_out(&desk->edges, room->memory, &low.batch->pieces, low.number)
        || !lay_outline(desk, high) || !add_end(&room->rings, 0))
        return 0;
    Side sides[2] = {{&desk->edges, 1.0, NOWHERE, NULL},
                     {&desk->outline.edges, 1.0, NOWHERE, NULL}};
    const Outcome outcome = intersect(room, sides, &desk->outline, task->tolerance);
    if (outcome == DOUBTFUL)
        return ask_library(task, slab, places, area);
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

/* Tell whether a piece holds a point. */
static int holds(Piece piece, const double *point)
{
    return region_holds(&piece.batch->pieces, piece.number, point);
}

/* Add two pieces to the overlaps if they have an area in common. */
static int add_overlap(Task *task, Desk *desk, Py_ssize_t slab, int64_t low, int64_t high)
{
    const Piece pieces[2] = {piece_at(task, slab, 0, low), piece_at(task, slab, 1, high)};
    const Box *one = &pieces[0].batch->boxes[pieces[0].number];
    const Box *other = &pieces[1].batch->boxes[pieces[1].number];
    if (!boxes_overlap(one, other))
        return 1;
    Overlap found = {{low, high}, NAN, 0};
    double middle[2];
    for (int axis = 0; axis < 2; axis++)
        middle[axis] = (greater(one->low[axis], other->low[axis])
                        + lesser(one->high[axis], other->high[axis])) / 2;
    if (!holds(pieces[0], middle) || !holds(pieces[1], middle)) {
        if (!measure_common(task, desk, slab, found.place, &found.common))
            return 0;
        if (!(found.common > 0))
            return 1;
    }
    Overlap *overlap = appended(&desk->overlaps, sizeof(Overlap));
    if (overlap != NULL)
        *overlap = found;
    return overlap != NULL;
}

/* Find the overlaps of a slab; advance in the list of pairs to try. */
static int find_overlaps(Task *task, Desk *desk, Py_ssize_t slab, Py_ssize_t *listed)
{
    const Layer *layers = task->layers + 2 * slab;
    desk->overlaps.count = 0;
    if (layers[1].count == 0 || layers[0].count <= task->most_tried / layers[1].count) {
        for (int64_t low = 0; low < layers[0].count; low++)
            for (int64_t high = 0; high < layers[1].count; high++)
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
static int are_images(const Task *task, Piece low, Piece high)
{
    const double ratio = low.batch->areas[low.number] / high.batch->areas[high.number];
    const Box *one = &low.batch->boxes[low.number], *other = &high.batch->boxes[high.number];
    int are_similar = ratio > task->area_ratio && ratio < 1 / task->area_ratio;
    for (int axis = 0; axis < 2; axis++) {
        const double width = one->high[axis] - one->low[axis];
        const double other_width = other->high[axis] - other->low[axis];
        are_similar &= lesser(width, other_width) > task->width_ratio * greater(width, other_width);
    }
    return are_similar;
}

/* Number a slab's pieces as nodes: those below, then those above. */
static Node *count_degrees(const Task *task, Desk *desk, Py_ssize_t slab)
{
    const int64_t below = task->layers[2 * slab].count;
    const int64_t count = below + task->layers[2 * slab + 1].count;
    Node *nodes = reserved(&desk->nodes, (size_t)count, sizeof(Node));
    const Overlap *overlaps = desk->overlaps.items;
    if (nodes == NULL)
        return NULL;
    for (int64_t node = 0; node < count; node++)
        nodes[node] = (Node){0, node, 0};
    for (size_t place = 0; place < desk->overlaps.count; place++) {
        nodes[overlaps[place].place[0]].degree++;
        nodes[below + overlaps[place].place[1]].degree++;
    }
    return nodes;
}

/* Return a piece's first contour in its batch. */
static int64_t first_contour(Piece piece)
{
    return piece.batch->pieces.regions[piece.number];
}

/* Return the number of a piece's contours. */
static int64_t contours_of(Piece piece)
{
    return piece.batch->pieces.regions[piece.number + 1] - first_contour(piece);
}

/* Add a slab's pairs: pieces alike that overlap nothing else, with as many contours. */
static int add_pairs(const Task *task, Desk *desk, Py_ssize_t slab, Node *nodes)
{
    Overlap *overlap = desk->overlaps.items;
    const int64_t below = task->layers[2 * slab].count;
    const Piece first[2] = {piece_at(task, slab, 0, 0), piece_at(task, slab, 1, 0)};
    for (size_t left = desk->overlaps.count; left > 0; left--, overlap++) {
        const int64_t *place = overlap->place;
        Node *const low = nodes + place[0], *const high = nodes + below + place[1];
        const Piece pieces[2] = {piece_at(task, slab, 0, place[0]),
                                 piece_at(task, slab, 1, place[1])};
        const int64_t contours = contours_of(pieces[0]);
        if (low->degree != 1 || high->degree != 1 || contours_of(pieces[1]) != contours
            || !are_images(task, pieces[0], pieces[1]))
            continue;
        const int64_t row[PAIR] = {slab, place[0], place[1],
                                   first_contour(pieces[0]) - first_contour(first[0]),
                                   first_contour(pieces[1]) - first_contour(first[1]), contours};
        if (!add_row(&desk->pairs, row, PAIR))
            return 0;
        overlap->is_pair = low->is_paired = high->is_paired = 1;
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
        const int64_t other = root_of(nodes, task->layers[2 * slab].count + overlap->place[1]);
        nodes[one > other ? one : other].parent = one > other ? other : one;
        if (isnan(overlap->common)
            && !measure_common(task, desk, slab, overlap->place, &overlap->common))
            return 0;
        *common += overlap->common;
    }
    return 1;
}

/* Add the pieces that are in no pair: those that overlap none, and the members of knots. */
static int add_others(const Task *task, Desk *desk, Py_ssize_t slab, Node *nodes, double *areas)
{
    const int64_t below = task->layers[2 * slab].count;
    const int64_t count = below + task->layers[2 * slab + 1].count;
    for (int64_t node = 0; node < count; node++) {
        if (nodes[node].is_paired)
            continue;
        const int side = node >= below;
        const int64_t place = side ? node - below : node;
        const int64_t alone[ALONE] = {slab, side, place};
        const int64_t member[MEMBER] = {slab, root_of(nodes, node), side, place};
        if (!(nodes[node].degree == 0 ? add_row(&desk->alone, alone, ALONE)
                                      : add_row(&desk->members, member, MEMBER)))
            return 0;
        const Piece piece = piece_at(task, slab, side, place);
        areas[side] += piece.batch->areas[piece.number];
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
            || !add_others(task, desk, slab, nodes, shares))
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
    free_room(&desk->clipping);
    free_outline(&desk->outline);
    free(desk->overlaps.items);
    free(desk->nodes.items);
    free(desk->pairs.items);
    free(desk->members.items);
    free(desk->alone.items);
    free(desk->shares.items);
}

/* --- Python ------------------------------------------------------------------------------- */

enum { POINTS, RINGS, PIECES, AREAS, BOXES, BATCH_ARRAYS };

static const ArrayKind BATCH_KINDS[BATCH_ARRAYS] = {
    {"points", 'd', 2, 0}, {"rings", 'q', 0, 0}, {"pieces", 'q', 0, 0},
    {"areas", 'd', 0, 0},  {"boxes", 'd', 4, 0},
};

enum { LAYERS, LISTED, ARRAYS };

static const ArrayKind KINDS[ARRAYS] = {{"layers", 'q', 3, 0}, {"listed", 'q', 3, 0}};

enum {
    BATCHES = ARRAYS, LIBRARY, MOST_TRIED, AREA_RATIO, WIDTH_RATIO, TOLERANCE, ARGUMENTS
};

/* Take over the arrays of batches, one behind the other; return whether they agree. */
static int are_batches(const Py_buffer *views, Batch *batches, Py_ssize_t count)
{
    int is_good = 1;
    for (Py_ssize_t place = 0; is_good && place < count; place++, views += BATCH_ARRAYS) {
        Batch *batch = &batches[place];
        batch->areas = views[AREAS].buf;
        batch->boxes = views[BOXES].buf;
        is_good = are_regions(views, &batch->pieces)
                  && views[AREAS].shape[0] == batch->pieces.count
                  && views[BOXES].shape[0] == batch->pieces.count;
    }
    return is_good;
}

/* Tell whether layers are among the pieces, and what is listed among the layers, in order. */
static int is_consistent(const Py_buffer *views, Task *task)
{
    task->layers = views[LAYERS].buf;
    task->slabs = views[LAYERS].shape[0] / 2;
    task->listed = views[LISTED].buf;
    task->listed_count = views[LISTED].shape[0];
    int is_good = views[LAYERS].shape[0] == 2 * task->slabs && task->most_tried >= 0
                  && task->tolerance >= 0 && task->tolerance <= MOST;
    for (const Layer *layer = task->layers; is_good && layer < task->layers + 2 * task->slabs;
         layer++) {
        is_good = layer->batch >= 0 && layer->batch < task->batch_count && layer->first >= 0;
        const int64_t pieces = is_good ? task->batches[layer->batch].pieces.count : 0;
        is_good = is_good && layer->first <= pieces && layer->count >= 0
                  && layer->count <= pieces - layer->first;
    }
    for (Py_ssize_t place = 0; is_good && place < task->listed_count; place++) {
        const int64_t *row = task->listed + 3 * place, least = place > 0 ? row[-3] : 0;
        is_good = row[0] >= least && row[0] < task->slabs && row[1] >= 0 && row[2] >= 0
                  && row[1] < task->layers[2 * row[0]].count
                  && row[2] < task->layers[2 * row[0] + 1].count;
    }
    return is_good;
}

/* Match what has been checked; return NULL with an error set if memory or the library fails. */
static PyObject *matches_of(Task *task)
{
    PyObject *result = NULL;
    Desk desk = {0};
    task->thread = PyEval_SaveThread();
    const int is_good = match_all(task, &desk);
    PyEval_RestoreThread(task->thread);
    if (is_good)
        result = Py_BuildValue("NNNN", bytes_of(&desk.pairs), bytes_of(&desk.members),
                               bytes_of(&desk.alone), bytes_of(&desk.shares));
    else if (!PyErr_Occurred())
        PyErr_NoMemory();
    clear_desk(&desk);
    return result;
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
    Py_buffer *batch_views = get_tables(arguments[BATCHES], BATCH_KINDS, BATCH_ARRAYS);
    PyObject *result = NULL;
    if (batch_views != NULL) {
        task.batch_count = PyTuple_GET_SIZE(arguments[BATCHES]);
        task.batches = PyMem_Calloc((size_t)task.batch_count + 1, sizeof(Batch));
        if (task.batches == NULL)
            PyErr_NoMemory();
        else if (are_batches(batch_views, task.batches, task.batch_count)
                 && is_consistent(views, &task))
            result = matches_of(&task);
        else
            reject();
        PyMem_Free(task.batches);
        release_tables(batch_views, task.batch_count, BATCH_ARRAYS);
    }
    release_arrays(views, ARRAYS);
    return result;
}

static PyMethodDef METHODS[] = {
    METHOD(match,
           "Pair the pieces of adjacent layers that overlap nothing else, and group the others."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_matching)
