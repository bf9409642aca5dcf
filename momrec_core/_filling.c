/* Regions between contours cut into triangles, where nothing is degenerate.
 *
 * Holes are joined to what is around them by bridges, and ears are cut off (D. Eberly, Triangulation
 * by ear clipping, 2002), one whose diagonal costs less than those of the ears beside it first. All
 * triangles have clearly positive areas: where contours bound a region, they cover it once. A region
 * where that does not come out is reported instead, for a library that also knows what to do there.
 */

#include "_bounds.h"
#include "_module.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_VERTICES = 4000 }; /* of a region: time may grow with their square */
static const double FLAT = 1e-9; /* of the diagonal: an ear of less height may be rounding */
static const double LEVEL = 4.0; /* ears that don't lead to the other layer wait: each takes volume */

/* A corner of what is left of a region, and the edge from it to the next. */
typedef struct {
    double x, y, z;
    int64_t vertex, previous, next;
    double key;                /* what cutting it off costs, or infinity if it can't be */
    uint8_t is_cut, may_block; /* cut off; not clearly convex, so that it may lie in ears */
} Node;

/* Nodes that may lie in ears, entered in strips across a region's longer side. */
typedef struct {
    int64_t count, axis;
    double low, per_unit;
    int64_t *ends;   /* (count + 1,): strip i has places[ends[i]] up to places[ends[i + 1]] */
    int64_t *places; /* (nodes,) */
} Strips;

/* A contour seen from above. */
typedef struct {
    int64_t loop, leftmost; /* its place among all, and the place of a vertex in it */
    double x;               /* of this vertex */
    double area;            /* twice, with its sign */
} Contour;

/* A region being cut. */
typedef struct {
    Node *nodes;
    Strips strips;
    Contour *holes;
    int64_t node_count;
    int64_t *triangles; /* out: vertices, in the order that the region faces */
    int64_t triangle_count;
    int is_up;
} Room;

/* The arrays of a call, checked. */
typedef struct {
    const double *points;    /* (n, 3) */
    const int64_t *vertices; /* (m,): along all contours, with the region on the left */
    const int64_t *loops;    /* (loops + 1,): where each contour begins, and where the last ends */
    const int64_t *regions;  /* (regions + 1,): the first contour of each, and how many there are */
    const uint8_t *faces_up; /* (regions,) */
    int64_t *triangles;      /* (m + 2 * loops, 3), out: region by region */
    int64_t *counts;         /* (regions,), out: triangles, or -1 where that is doubtful */
    Py_ssize_t count;        /* regions */
} Work;

/* Twice the area of a triangle seen from above. */
static double cross(const Node *a, const Node *b, const Node *c)
{
    return (b->x - a->x) * (c->y - a->y) - (b->y - a->y) * (c->x - a->x);
}

/* The square of the distance seen from above. */
static double square(const Node *a, const Node *b)
{
    return (b->x - a->x) * (b->x - a->x) + (b->y - a->y) * (b->y - a->y);
}

/* How much a diagonal costs: the longer it is, and the more where all of its ear lies level. */
static double cost_of_ear(const Node *a, const Node *b, const Node *c)
{
    const int is_level = a->z == b->z && b->z == c->z;
    return (is_level ? LEVEL : 1.0) * square(a, c);
}

static int is_same_place(const Node *a, const Node *b) { return a->x == b->x && a->y == b->y; }

/* --- contours and bridges ------------------------------------------------------------------- */

static Contour measure_loop(const Work *work, int64_t loop)
{
    const int64_t *vertices = work->vertices + work->loops[loop];
    const int64_t count = work->loops[loop + 1] - work->loops[loop];
    const double *origin = work->points + 3 * vertices[0], *before = origin;
    Contour contour = {loop, 0, origin[0], 0.0};
    for (int64_t place = 1; place < count; place++) {
        const double *point = work->points + 3 * vertices[place];
        contour.area += (before[0] - origin[0]) * (point[1] - origin[1])
                        - (before[1] - origin[1]) * (point[0] - origin[0]);
        if (point[0] < contour.x) {
            contour.x = point[0];
            contour.leftmost = place;
        }
        before = point;
    }
    return contour;
}

/* Enter a contour; return its first node. */
static int64_t enter_loop(const Work *work, int64_t loop, Room *room)
{
    const int64_t *vertices = work->vertices + work->loops[loop];
    const int64_t count = work->loops[loop + 1] - work->loops[loop], base = room->node_count;
    for (int64_t place = 0; place < count; place++) {
        const double *point = work->points + 3 * vertices[place];
        const int64_t number = base + place;
        room->nodes[number] = (Node){point[0], point[1], point[2], vertices[place],
                                     number - 1, number + 1, INFINITY, 0, 0};
    }
    room->nodes[base].previous = base + count - 1;
    room->nodes[base + count - 1].next = base;
    room->node_count += count;
    return base;
}

/* Tell whether a node's corner of the region opens towards another. */
static int opens_to(const Node *nodes, const Node *node, const Node *other)
{
    const Node *previous = nodes + node->previous, *next = nodes + node->next;
    const int is_left_of_next = cross(node, next, other) > 0;
    const int is_left_of_previous = cross(previous, node, other) > 0;
    return cross(previous, node, next) > 0 ? is_left_of_next && is_left_of_previous
                                           : is_left_of_next || is_left_of_previous;
}

/* Return the node that a hole's leftmost one sees, among some nodes to its left, or -1. */
static int64_t find_bridge(const Node *nodes, int64_t count, const Node *hole)
{
    double nearest = -INFINITY;
    int64_t edge = -1;
    for (int64_t place = 0; place < count; place++) {
        const Node *a = nodes + place, *b = nodes + a->next;
        if (a->y <= hole->y || b->y > hole->y)
            continue;
        const double x = a->x + (hole->y - a->y) / (b->y - a->y) * (b->x - a->x);
        if (x <= hole->x && x > nearest) {
            nearest = x;
            edge = place;
        }
    }
    if (edge < 0)
        return -1;
    const Node *end = nodes + (nodes[edge].x < nodes[nodes[edge].next].x ? edge : nodes[edge].next);
    const Node hit = {.x = nearest, .y = hole->y};
    const double turn = end->y > hole->y ? 1.0 : -1.0;
    double least = INFINITY;
    int64_t best = -1;
    for (int64_t place = 0; place < count; place++) {
        const Node *node = nodes + place;
        if (node->x >= hole->x || node->x < end->x || turn * (node->y - hole->y) < 0)
            continue;
        if (!is_same_place(node, end) && (turn * cross(hole, node, end) > 0
                                          || turn * cross(&hit, end, node) > 0))
            continue;
        const double slope = fabs(node->y - hole->y) / (hole->x - node->x);
        if ((slope < least || (best >= 0 && slope == least && node->x > nodes[best].x))
            && opens_to(nodes, node, hole)) {
            least = slope;
            best = place;
        }
    }
    return best;
}

/* Join a hole to a node by a bridge: from the node to the hole, around it and back to a twin. */
static void lay_bridge(Room *room, int64_t outer, int64_t hole)
{
    Node *nodes = room->nodes;
    const int64_t hole_twin = room->node_count++, outer_twin = room->node_count++;
    nodes[hole_twin] = nodes[hole];
    nodes[outer_twin] = nodes[outer];
    nodes[nodes[hole].previous].next = hole_twin;
    nodes[nodes[outer].next].previous = outer_twin;
    nodes[hole_twin].next = outer_twin;
    nodes[outer_twin].previous = hole_twin;
    nodes[outer].next = hole;
    nodes[hole].previous = outer;
}

static int compare_holes(const void *one, const void *other)
{
    const Contour *a = one, *b = other;
    return a->x != b->x ? (a->x < b->x ? -1 : 1) : (a->loop > b->loop) - (a->loop < b->loop);
}

/* Enter the contours of a region, its holes joined to what is around them, the leftmost one first.
 * Return how many triangles there will be, or -1. */
static int64_t enter_region(const Work *work, Py_ssize_t region, Room *room)
{
    int64_t outlines = 0, holes = 0;
    room->node_count = 0;
    for (int64_t loop = work->regions[region]; loop < work->regions[region + 1]; loop++) {
        const Contour contour = measure_loop(work, loop);
        if (contour.area > 0) {
            enter_loop(work, loop, room);
            outlines++;
        } else if (contour.area < 0) {
            room->holes[holes++] = contour;
        } else {
            return -1;
        }
    }
    qsort(room->holes, (size_t)holes, sizeof(Contour), compare_holes);
    for (int64_t hole = 0; hole < holes; hole++) {
        const int64_t count = room->node_count;
        const int64_t leftmost = enter_loop(work, room->holes[hole].loop, room)
                                 + room->holes[hole].leftmost;
        const int64_t outer = find_bridge(room->nodes, count, room->nodes + leftmost);
        if (outer < 0)
            return -1;
        lay_bridge(room, outer, leftmost);
    }
    return room->node_count - 2 * outlines;
}

/* --- ears ----------------------------------------------------------------------------------- */

/* Tell whether three corners turn to the left clearly. */
static int is_convex(const Node *a, const Node *b, const Node *c)
{
    return cross(a, b, c) > FLAT * square(a, c);
}

/* Tell whether a node keeps the corner b from being cut off along a diagonal. */
static int blocks(const Node *node, const Node *a, const Node *b, const Node *c)
{
    if (cross(a, b, node) < 0 || cross(b, c, node) < 0)
        return 0;
    return cross(c, a, node) >= -FLAT * square(a, c) && !is_same_place(node, a)
           && !is_same_place(node, b) && !is_same_place(node, c);
}

static int64_t strip_of(const Strips *strips, double at)
{
    const double strip = (at - strips->low) * strips->per_unit;
    return strip < (double)strips->count ? (int64_t)strip : strips->count - 1;
}

static double along(const Node *node, int64_t axis) { return axis ? node->y : node->x; }

/* Choose as many strips as nodes; all are entered in one where that is not finite. */
static void lay_strips(Room *room)
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int64_t place = 0; place < room->node_count; place++)
        for (int axis = 0; axis < 2; axis++) {
            const double at = along(room->nodes + place, axis);
            low[axis] = lesser(at, low[axis]);
            high[axis] = greater(at, high[axis]);
        }
    Strips *strips = &room->strips;
    strips->axis = high[1] - low[1] > high[0] - low[0];
    strips->low = low[strips->axis];
    strips->count = room->node_count;
    strips->per_unit = (double)strips->count / (high[strips->axis] - strips->low);
    if (!isfinite(strips->per_unit))
        strips->per_unit = 0.0;
}

/* Enter the nodes that are not clearly convex in their strips. */
static void fill_strips(Room *room)
{
    Node *nodes = room->nodes;
    Strips *strips = &room->strips;
    memset(strips->ends, 0, (size_t)(strips->count + 1) * sizeof(int64_t));
    for (int64_t place = 0; place < room->node_count; place++) {
        Node *node = nodes + place;
        node->may_block = !is_convex(nodes + node->previous, node, nodes + node->next);
        if (node->may_block)
            strips->ends[strip_of(strips, along(node, strips->axis))]++;
    }
    for (int64_t strip = 1; strip <= strips->count; strip++)
        strips->ends[strip] += strips->ends[strip - 1];
    for (int64_t place = room->node_count - 1; place >= 0; place--)
        if (nodes[place].may_block)
            strips->places[--strips->ends[strip_of(strips, along(nodes + place, strips->axis))]] =
                place;
}

/* Tell whether no node lies in a triangle. */
static int is_free(const Room *room, const Node *a, const Node *b, const Node *c)
{
    const Strips *strips = &room->strips;
    const double at[3] = {along(a, strips->axis), along(b, strips->axis), along(c, strips->axis)};
    const int64_t first = strip_of(strips, lesser(at[0], lesser(at[1], at[2])));
    const int64_t last = strip_of(strips, greater(at[0], greater(at[1], at[2])));
    for (int64_t index = strips->ends[first]; index < strips->ends[last + 1]; index++) {
        const Node *node = room->nodes + strips->places[index];
        if (node->may_block && blocks(node, a, b, c))
            return 0;
    }
    return 1;
}

/* Find out whether a node is the tip of an ear. */
static void look_at(Room *room, int64_t place)
{
    Node *nodes = room->nodes, *b = nodes + place;
    const Node *a = nodes + b->previous, *c = nodes + b->next;
    b->may_block = !is_convex(a, b, c);
    b->key = !b->may_block && is_free(room, a, b, c) ? cost_of_ear(a, b, c) : INFINITY;
}

static void cut_ear(Room *room, int64_t tip)
{
    Node *nodes = room->nodes;
    const int64_t before = nodes[tip].previous, after = nodes[tip].next;
    int64_t *triangle = room->triangles + 3 * room->triangle_count++;
    triangle[room->is_up ? 0 : 2] = nodes[before].vertex;
    triangle[1] = nodes[tip].vertex;
    triangle[room->is_up ? 2 : 0] = nodes[after].vertex;
    nodes[before].next = after;
    nodes[after].previous = before;
    nodes[tip].is_cut = 1;
    nodes[tip].may_block = 0;
    if (nodes[after].next == before) {
        nodes[before].is_cut = nodes[after].is_cut = 1;
    } else {
        look_at(room, before);
        look_at(room, after);
    }
}

/* Cut off ears whose diagonal costs less than those beside, from a node on, until nothing is left;
 * return whether it comes to that. */
static int cut_around(Room *room, int64_t place)
{
    const Node *nodes = room->nodes;
    int64_t idle = 0;
    while (!nodes[place].is_cut && idle <= room->node_count) {
        const Node *node = nodes + place;
        const int64_t before = node->previous, after = node->next;
        if (node->key < INFINITY && node->key <= nodes[before].key
            && node->key <= nodes[after].key) {
            cut_ear(room, place);
            place = before;
            idle = 0;
        } else {
            place = after;
            idle++;
        }
    }
    return nodes[place].is_cut;
}

/* Cut a region into ears; return whether all of it is. */
static int cut_ears(Room *room)
{
    lay_strips(room);
    fill_strips(room);
    room->triangle_count = 0;
    for (int64_t place = 0; place < room->node_count; place++)
        look_at(room, place);
    for (int64_t place = 0; place < room->node_count; place++)
        if (!room->nodes[place].is_cut && !cut_around(room, place))
            return 0;
    return 1;
}

/* --- regions -------------------------------------------------------------------------------- */

/* Triangulate all regions. */
static void fill_all(const Work *work, Room *room)
{
    room->triangles = work->triangles;
    for (Py_ssize_t region = 0; region < work->count; region++) {
        const int64_t *loops = work->loops + work->regions[region];
        const int64_t count = work->regions[region + 1] - work->regions[region];
        work->counts[region] = -1;
        if (loops[count] - loops[0] > MOST_VERTICES)
            continue;
        room->is_up = work->faces_up[region];
        const int64_t expected = enter_region(work, region, room);
        if (expected >= 0 && cut_ears(room) && room->triangle_count == expected) {
            work->counts[region] = expected;
            room->triangles += 3 * expected;
        }
    }
}

/* Get memory for the largest region that is triangulated here; return whether there is enough. */
static int get_room(const Work *work, Room *room)
{
    int64_t most_nodes = 1, most_holes = 1;
    for (Py_ssize_t region = 0; region < work->count; region++) {
        const int64_t *loops = work->loops + work->regions[region];
        const int64_t count = work->regions[region + 1] - work->regions[region];
        const int64_t vertices = loops[count] - loops[0];
        if (vertices > MOST_VERTICES)
            continue;
        most_nodes = vertices + 2 * count > most_nodes ? vertices + 2 * count : most_nodes;
        most_holes = count > most_holes ? count : most_holes;
    }
    const size_t nodes = (size_t)most_nodes;
    *room = (Room){
        .nodes = malloc(nodes * sizeof(Node)),
        .strips.ends = malloc((nodes + 1) * sizeof(int64_t)),
        .strips.places = malloc(nodes * sizeof(int64_t)),
        .holes = malloc((size_t)most_holes * sizeof(Contour)),
    };
    return room->nodes && room->strips.ends && room->strips.places && room->holes;
}

static void free_room(Room *room)
{
    free(room->nodes);
    free(room->strips.ends);
    free(room->strips.places);
    free(room->holes);
}

/* --- arrays from Python --------------------------------------------------------------------- */

enum { POINTS, VERTICES, LOOPS, REGIONS, FACES_UP, TRIANGLES, COUNTS, ARRAYS };

static int is_consistent(const Py_buffer *views)
{
    const Py_ssize_t vertices = views[VERTICES].shape[0], loops = views[LOOPS].shape[0] - 1;
    const Py_ssize_t regions = views[REGIONS].shape[0] - 1;
    if (!are_ends(&views[LOOPS], vertices, 1) || !are_ends(&views[REGIONS], loops, 0))
        return 0;
    return are_within(views[VERTICES].buf, vertices, views[POINTS].shape[0])
           && views[FACES_UP].shape[0] == regions && views[COUNTS].shape[0] == regions
           && views[TRIANGLES].shape[0] == vertices + 2 * loops;
}

static PyObject *fill(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    const ArrayKind expected[ARRAYS] = {
        {"points", 'd', 3, 0},   {"vertices", 'q', 0, 0},  {"loops", 'q', 0, 0},
        {"regions", 'q', 0, 0},  {"faces_up", '?', 0, 0},  {"triangles", 'q', 3, 1},
        {"counts", 'q', 0, 1},
    };
    Py_buffer views[ARRAYS];
    if (!get_arrays(arguments, count, expected, ARRAYS, views))
        return NULL;
    const Work work = {views[POINTS].buf, views[VERTICES].buf, views[LOOPS].buf,
                       views[REGIONS].buf, views[FACES_UP].buf, views[TRIANGLES].buf,
                       views[COUNTS].buf, views[REGIONS].shape[0] - 1};
    const int good = is_consistent(views);
    int fits = 1;
    if (good) {
        Room room;
        Py_BEGIN_ALLOW_THREADS
        fits = get_room(&work, &room);
        if (fits)
            fill_all(&work, &room);
        free_room(&room);
        Py_END_ALLOW_THREADS
    }
    return ended(views, ARRAYS, good, fits,
                 "Expected contours with vertices, one behind the other, regions of them, and "
                 "arrays that agree");
}

static PyMethodDef METHODS[] = {
    METHOD(fill, "Cut the regions between contours into triangles."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_filling)
