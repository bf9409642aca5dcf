/* Regions of many planes intersected with one outline each, where nothing is degenerate.
 *
 * Boundaries that cross away from their vertices are cut at the crossings and joined anew (K.
 * Weiler and P. Atherton, Hidden surface removal using polygon area sorting, 1977). A plane where
 * a vertex comes near the other boundary, where crossings lie upon each other, or where they do
 * not alternate between inward and outward is reported instead, for a library that also knows
 * what to do there.
 */

#ifndef MOMREC_CLIPPING_H
#define MOMREC_CLIPPING_H

#include "_arrays.h"
#include "_bounds.h"
#include "_lists.h"
#include "_plane.h"
#include "_sorting.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { EDGES_A_CELL = 2, MOST_ROWS = 1000 }; /* of the grid in which edges are looked up */
static const double MOST = 1e75; /* of a coordinate: so that no product of four overflows */
enum { RESULTS = 3 }; /* lists that regions are kept in */

/* Rings, one behind the other, and regions of rings, likewise; the inside is on their left. */
typedef struct {
    const double *points;   /* (n, 2) */
    const int64_t *rings;   /* (rings + 1,): where each begins, and where the last ends */
    const int64_t *regions; /* (regions + 1,): the first ring of each, and how many there are */
    Py_ssize_t count;       /* regions */
} Regions;

typedef struct {
    double low[2], high[2];
} Box;

/* A region's edges: edge i goes from vertex i to vertex next[i]. */
typedef struct {
    int64_t count, rings;
    const double *points; /* (count, 2) */
    int64_t *next, *ring; /* (count,) */
    int64_t *first;       /* (rings + 1,) */
} Edges;

typedef struct {
    Box box;
    int64_t edge;
    int64_t first[2]; /* the least column and row that the edge meets */
} Entry;

/* Edges, entered in the cells of a grid over their box. */
typedef struct {
    Box box;
    int64_t counts[2]; /* columns and rows */
    double per_unit[2];
    int64_t *ends; /* cell i has entries[ends[i]] up to entries[ends[i + 1]] */
    Entry *entries;
} Grid;

static const double NOWHERE[2] = {0.0, 0.0}; /* the shift of a region that stays where it is */

/* One of two regions in a plane: edges, scaled and shifted. */
typedef struct {
    const Edges *edges;
    double scale;
    const double *shift;
    uint8_t *is_crossed; /* (rings,) */
} Side;

typedef struct {
    double point[2];
    double at[2];    /* where along the edges of both sides */
    int64_t edge[2]; /* these edges */
    int64_t next[2]; /* the crossing that follows along each side's ring */
    uint8_t enters;  /* whether the first side's edge goes into the second side */
    uint8_t is_used;
} Crossing;

/* A crossing's place along one side. */
typedef struct {
    int64_t edge;
    double at;
    int64_t crossing;
} Place;

/* An outline that many planes are clipped with. */
typedef struct {
    List memory[3], cells, entries;
    Edges edges;
    Grid grid;
    int is_laid;
} Outline;

typedef struct {
    List before[RESULTS]; /* results that are clipped further */
    List memory[3];       /* of a plane's region, reused from plane to plane like the next ones */
    List is_crossed[2], crossings, places;
    List points, rings, regions; /* results: three lists */
} Room;

typedef enum { DONE, DOUBTFUL, NO_MEMORY } Outcome;

static inline int add_point(Room *room, const double *point)
{
    double *place = appended(&room->points, 2 * sizeof(double));
    if (place != NULL)
        memcpy(place, point, 2 * sizeof(double));
    return place != NULL;
}

/* End a list of rings or regions at what has been counted so far. */
static inline int add_end(List *ends, size_t count)
{
    int64_t *end = appended(ends, sizeof(int64_t));
    if (end != NULL)
        *end = (int64_t)count;
    return end != NULL;
}

/* End what comes before the first ring and the first region: nothing. */
static inline int begin_results(Room *room)
{
    return add_end(&room->rings, 0) && add_end(&room->regions, 0);
}

/* --- edges -------------------------------------------------------------------------------- */

static const Box EMPTY = {{INFINITY, INFINITY}, {-INFINITY, -INFINITY}};

/* Let a box grow until it holds a point. */
static inline void include(Box *box, const double *point)
{
    for (int axis = 0; axis < 2; axis++) {
        box->low[axis] = lesser(box->low[axis], point[axis]);
        box->high[axis] = greater(box->high[axis], point[axis]);
    }
}

/* Lay a region's edges out in three lists, which the result points to. */
static inline int lay_out(Edges *edges, List *memory, const Regions *from, int64_t region)
{
    const int64_t *rings = from->rings + from->regions[region];
    edges->rings = from->regions[region + 1] - from->regions[region];
    edges->count = rings[edges->rings] - rings[0];
    edges->points = from->points + 2 * rings[0];
    edges->next = reserved(&memory[0], (size_t)edges->count, sizeof(int64_t));
    edges->ring = reserved(&memory[1], (size_t)edges->count, sizeof(int64_t));
    edges->first = reserved(&memory[2], (size_t)edges->rings + 1, sizeof(int64_t));
    if (!edges->next || !edges->ring || !edges->first)
        return 0;
    for (int64_t ring = 0; ring < edges->rings; ring++) {
        const int64_t begin = rings[ring] - rings[0], end = rings[ring + 1] - rings[0];
        edges->first[ring] = begin;
        for (int64_t vertex = begin; vertex < end; vertex++) {
            edges->next[vertex] = vertex + 1 < end ? vertex + 1 : begin;
            edges->ring[vertex] = ring;
        }
    }
    edges->first[edges->rings] = edges->count;
    return 1;
}

/* Return where a vertex of a side is in the plane. */
static inline void find_vertex(const Side *side, int64_t vertex, double *point)
{
    for (int axis = 0; axis < 2; axis++)
        point[axis] = side->scale * side->edges->points[2 * vertex + axis] + side->shift[axis];
}

/* Tell whether a point lies inside what rings bound; `rings` tells where they begin and end. */
static inline int is_bounded(const double *points, const int64_t *rings, int64_t count,
                             const double *point)
{
    int inside = 0;
    for (int64_t ring = 0; ring < count; ring++) {
        const double *start = points + 2 * (rings[ring + 1] - 1);
        const double *end = points + 2 * rings[ring];
        for (; end < points + 2 * rings[ring + 1]; start = end, end += 2)
            inside ^= is_passed(start, end, point);
    }
    return inside;
}

/* Tell whether a point of the plane lies inside a side. */
static inline int is_inside(const Side *side, const double *point)
{
    const Edges *edges = side->edges;
    double own[2];
    for (int axis = 0; axis < 2; axis++)
        own[axis] = (point[axis] - side->shift[axis]) / side->scale;
    return is_bounded(edges->points, edges->first, edges->rings, own);
}

/* Tell whether a point lies inside a region. */
static inline int region_holds(const Regions *regions, int64_t region, const double *point)
{
    const int64_t *first = regions->regions + region;
    return is_bounded(regions->points, regions->rings + first[0], first[1] - first[0], point);
}

/* --- crossings ---------------------------------------------------------------------------- */

static inline double length_of(const double *start, const double *end)
{
    const double x = end[0] - start[0], y = end[1] - start[1];
    return sqrt(x * x + y * y);
}

/* Tell whether a point beside a segment, by the cross product, comes near it. */
static inline int is_near(const double *start, const double *end, const double *point,
                          double beside, double length, double tolerance)
{
    if (fabs(beside) > tolerance * length)
        return 0;
    const double along = (end[0] - start[0]) * (point[0] - start[0])
                         + (end[1] - start[1]) * (point[1] - start[1]);
    return along >= -tolerance * length && along <= (length + tolerance) * length;
}

/* Look at an edge of each side; add their crossing if they have one. */
static inline Outcome cross_edges(Room *room, const Side *sides, const int64_t edges[2],
                                  double tolerance)
{
    double start[2][2], end[2][2], before[2], after[2], length[2];
    for (int side = 0; side < 2; side++) {
        find_vertex(&sides[side], edges[side], start[side]);
        find_vertex(&sides[side], sides[side].edges->next[edges[side]], end[side]);
    }
    int is_clear = 1;
    for (int side = 0; side < 2; side++) { /* the ends of this side's edge beside the other's */
        const int other = !side;
        before[side] = cross(start[other], end[other], start[side]);
        after[side] = cross(start[other], end[other], end[side]);
        length[other] = length_of(start[other], end[other]);
        const double least = tolerance * length[other];
        if (fabs(before[side]) > least && fabs(after[side]) > least) {
            if ((before[side] > 0) == (after[side] > 0))
                return DONE;
        } else {
            is_clear = 0;
        }
    }
    if (!is_clear) {
        for (int side = 0; side < 2; side++) {
            const int other = !side;
            if (is_near(start[other], end[other], start[side], before[side], length[other],
                        tolerance)
                || is_near(start[other], end[other], end[side], after[side], length[other],
                           tolerance))
                return DOUBTFUL;
        }
        const int crosses = (before[0] > 0) != (after[0] > 0) && (before[1] > 0) != (after[1] > 0);
        return crosses ? DOUBTFUL : DONE;
    }
    Crossing *crossing = appended(&room->crossings, sizeof(Crossing));
    if (crossing == NULL)
        return NO_MEMORY;
    for (int side = 0; side < 2; side++) {
        crossing->edge[side] = edges[side];
        crossing->at[side] = before[side] / (before[side] - after[side]);
        sides[side].is_crossed[sides[side].edges->ring[edges[side]]] = 1;
    }
    for (int axis = 0; axis < 2; axis++)
        crossing->point[axis] = start[0][axis] + crossing->at[0] * (end[0][axis] - start[0][axis]);
    crossing->enters = after[0] > 0;
    crossing->is_used = 0;
    return DONE;
}

/* --- looking edges up --------------------------------------------------------------------- */

static inline Box box_of(const Edges *edges, int64_t edge)
{
    const double *start = edges->points + 2 * edge, *end = edges->points + 2 * edges->next[edge];
    Box box;
    for (int axis = 0; axis < 2; axis++) {
        box.low[axis] = lesser(start[axis], end[axis]);
        box.high[axis] = greater(start[axis], end[axis]);
    }
    return box;
}

static inline int boxes_meet(const Box *one, const Box *other)
{
    return (one->low[0] <= other->high[0]) & (other->low[0] <= one->high[0])
           & (one->low[1] <= other->high[1])
           & (other->low[1] <= one->high[1]); /* all four: a branch at each would cost more */
}

/* Find the column and the row of a corner of a box. */
static inline void find_cell(const Outline *outline, const double *corner, int64_t *cell)
{
    for (int axis = 0; axis < 2; axis++) {
        const double place = (corner[axis] - outline->grid.box.low[axis])
                             * outline->grid.per_unit[axis];
        const double last = (double)(outline->grid.counts[axis] - 1);
        cell[axis] = (int64_t)greater(0.0, lesser(place, last));
    }
}

/* Choose how many cells, so that the edges meet a few each on average, however long they are. */
static inline void choose_cells(Outline *outline)
{
    const Edges *edges = &outline->edges;
    double spans[2] = {0.0, 0.0}, areas = 0.0;
    for (int64_t edge = 0; edge < edges->count; edge++) {
        const Box box = box_of(edges, edge);
        for (int axis = 0; axis < 2; axis++)
            spans[axis] += box.high[axis] - box.low[axis];
        areas += (box.high[0] - box.low[0]) * (box.high[1] - box.low[1]);
    }
    const Box *all = &outline->grid.box;
    const double extents[2] = {all->high[0] - all->low[0], all->high[1] - all->low[1]};
    const double whole = extents[0] * extents[1], count = (double)edges->count;
    const double shared = areas > 0 ? count * whole / areas : INFINITY;
    const double fair = lesser(sqrt(lesser(count / EDGES_A_CELL, shared)), MOST_ROWS);
    for (int axis = 0; axis < 2; axis++) {
        const double extent = extents[axis];
        const double most = extent > 0 ? count * extent / spans[axis] : 0.0;
        outline->grid.counts[axis] = 1 + (int64_t)lesser(fair, most);
        outline->grid.per_unit[axis] = extent > 0 ? (double)outline->grid.counts[axis] / extent : 0;
    }
}

/* Enter the edges of an outline in the cells of a grid. */
static inline int enter_edges(Outline *outline)
{
    Grid *grid = &outline->grid;
    grid->box = EMPTY;
    for (int64_t vertex = 0; vertex < outline->edges.count; vertex++)
        include(&grid->box, outline->edges.points + 2 * vertex);
    choose_cells(outline);
    const size_t cells = (size_t)(grid->counts[0] * grid->counts[1]);
    grid->ends = reserved(&outline->cells, cells + 2, sizeof(int64_t));
    if (grid->ends == NULL)
        return 0;
    memset(grid->ends, 0, (cells + 2) * sizeof(int64_t));
    for (int enters = 0; enters < 2; enters++) { /* count them, then enter them */
        for (int64_t edge = 0; edge < outline->edges.count; edge++) {
            Entry entry = {.box = box_of(&outline->edges, edge), .edge = edge};
            int64_t last[2];
            find_cell(outline, entry.box.low, entry.first);
            find_cell(outline, entry.box.high, last);
            for (int64_t row = entry.first[1]; row <= last[1]; row++) {
                int64_t *ends = grid->ends + row * grid->counts[0];
                for (int64_t column = entry.first[0]; column <= last[0]; column++) {
                    if (enters)
                        grid->entries[ends[column + 1]++] = entry;
                    else
                        ends[column + 2]++;
                }
            }
        }
        if (enters)
            break;
        for (size_t cell = 2; cell < cells + 2; cell++)
            grid->ends[cell] += grid->ends[cell - 1];
        grid->entries = reserved(&outline->entries, (size_t)grid->ends[cells + 1], sizeof(Entry));
        if (grid->entries == NULL)
            return 0;
    }
    return 1;
}

/* Find the crossings of an edge of the first side with the outline's edges in one cell. */
static inline Outcome cross_cell(Room *room, const Side *sides, const Grid *grid, const Entry *edge,
                                 int64_t column, int64_t row, double tolerance)
{
    const int64_t cell = row * grid->counts[0] + column;
    for (int64_t place = grid->ends[cell]; place < grid->ends[cell + 1]; place++) {
        const Entry *other = &grid->entries[place];
        if (!boxes_meet(&edge->box, &other->box))
            continue;
        if (column != (other->first[0] > edge->first[0] ? other->first[0] : edge->first[0])
            || row != (other->first[1] > edge->first[1] ? other->first[1] : edge->first[1]))
            continue; /* not the first cell of both */
        const int64_t edges[2] = {edge->edge, other->edge};
        const Outcome outcome = cross_edges(room, sides, edges, tolerance);
        if (outcome != DONE)
            return outcome;
    }
    return DONE;
}

/* Find all crossings of two sides, the second of which is the outline. */
static inline Outcome find_crossings(Room *room, const Side *sides, const Outline *outline,
                                     double tolerance)
{
    const double per_scale = 1.0 / sides[1].scale, *shift = sides[1].shift;
    for (int64_t edge = 0; edge < sides[0].edges->count; edge++) {
        Entry entry = {.box = box_of(sides[0].edges, edge), .edge = edge};
        int64_t last[2];
        for (int axis = 0; axis < 2; axis++) { /* twice the tolerance, as this is rounded */
            entry.box.low[axis] = (entry.box.low[axis] - shift[axis] - 2 * tolerance) * per_scale;
            entry.box.high[axis] = (entry.box.high[axis] - shift[axis] + 2 * tolerance) * per_scale;
        }
        if (!boxes_meet(&entry.box, &outline->grid.box))
            continue;
        find_cell(outline, entry.box.low, entry.first);
        find_cell(outline, entry.box.high, last);
        for (int64_t row = entry.first[1]; row <= last[1]; row++) {
            for (int64_t column = entry.first[0]; column <= last[0]; column++) {
                const Outcome outcome = cross_cell(room, sides, &outline->grid, &entry, column,
                                                   row, tolerance);
                if (outcome != DONE)
                    return outcome;
            }
        }
    }
    return DONE;
}

/* --- joining ------------------------------------------------------------------------------ */

static inline int in_order(const void *one, const void *other)
{
    const Place *first = one, *second = other;
    if (first->edge != second->edge)
        return first->edge < second->edge ? -1 : 1;
    return (first->at > second->at) - (first->at < second->at);
}

/* Find the crossing after each along one side's rings. */
static inline Outcome link_crossings(Room *room, const Edges *edges, int which, double tolerance)
{
    Crossing *crossings = room->crossings.items;
    const size_t count = room->crossings.count;
    Place *places = reserved(&room->places, count, sizeof(Place));
    if (places == NULL)
        return NO_MEMORY;
    for (size_t place = 0; place < count; place++)
        places[place] = (Place){crossings[place].edge[which], crossings[place].at[which],
                                (int64_t)place};
    sort_items(places, count, sizeof(Place), in_order);
    size_t first = 0; /* of the ring */
    for (size_t place = 0; place < count; place++) {
        const int64_t ring = edges->ring[places[place].edge];
        const int is_last = place + 1 == count || edges->ring[places[place + 1].edge] != ring;
        const Place *next = &places[is_last ? first : place + 1];
        Crossing *here = &crossings[places[place].crossing], *there = &crossings[next->crossing];
        if (here->enters == there->enters)
            return DOUBTFUL;
        if (!is_last && next->edge == places[place].edge
            && fabs(here->point[0] - there->point[0]) <= tolerance
            && fabs(here->point[1] - there->point[1]) <= tolerance)
            return DOUBTFUL;
        here->next[which] = next->crossing;
        if (is_last)
            first = place + 1;
    }
    return DONE;
}

/* Add vertices of a side, one behind the other, from one to another. */
static inline int add_vertices(Room *room, const Side *side, int64_t first, int64_t last)
{
    const size_t before = room->points.count, count = before + (size_t)(last - first);
    double *points = reserved(&room->points, count, 2 * sizeof(double));
    if (points == NULL)
        return 0;
    for (int64_t vertex = first; vertex < last; vertex++)
        find_vertex(side, vertex, points + 2 * ((int64_t)before + vertex - first));
    room->points.count = count;
    return 1;
}

static inline int add_ring(Room *room, const Side *side, int64_t ring)
{
    const int64_t *ends = side->edges->first + ring;
    return add_vertices(room, side, ends[0], ends[1]) && add_end(&room->rings, room->points.count);
}

/* Add the rings of a side that cross nothing and lie inside the other side. */
static inline int add_whole_rings(Room *room, const Side *side, const Side *other)
{
    for (int64_t ring = 0; ring < side->edges->rings; ring++) {
        double point[2];
        find_vertex(side, side->edges->first[ring], point);
        if (!side->is_crossed[ring] && is_inside(other, point) && !add_ring(room, side, ring))
            return 0;
    }
    return 1;
}

/* Add the vertices of a side after one crossing and before the next. */
static inline int add_part(Room *room, const Side *side, int which, const Crossing *from,
                           const Crossing *to)
{
    const int64_t first = from->edge[which] + 1, last = to->edge[which] + 1;
    if (first < last || (first == last && from->at[which] < to->at[which]))
        return add_vertices(room, side, first, last);
    const int64_t *ends = side->edges->first + side->edges->ring[to->edge[which]];
    return add_vertices(room, side, first, ends[1]) && add_vertices(room, side, ends[0], last);
}

/* Follow the first side inside the second one, and the second inside the first, in turn. */
static inline int add_joined_rings(Room *room, const Side *sides)
{
    Crossing *crossings = room->crossings.items;
    for (size_t start = 0; start < room->crossings.count; start++) {
        if (crossings[start].is_used || !crossings[start].enters)
            continue;
        Crossing *here = &crossings[start];
        int which = 0;
        do {
            Crossing *next = &crossings[here->next[which]];
            here->is_used = 1;
            if (!add_point(room, here->point) || !add_part(room, &sides[which], which, here, next))
                return 0;
            here = next;
            which = !which;
        } while (here != &crossings[start]);
        if (!add_end(&room->rings, room->points.count))
            return 0;
    }
    return 1;
}

/* Intersect two sides, the second of which is the outline. */
static inline Outcome intersect(Room *room, Side *sides, const Outline *outline, double tolerance)
{
    room->crossings.count = 0;
    for (int which = 0; which < 2; which++) {
        const size_t rings = (size_t)sides[which].edges->rings;
        sides[which].is_crossed = reserved(&room->is_crossed[which], rings, 1);
        if (sides[which].is_crossed == NULL)
            return NO_MEMORY;
        memset(sides[which].is_crossed, 0, rings);
    }
    Outcome outcome = find_crossings(room, sides, outline, tolerance);
    for (int which = 0; which < 2 && outcome == DONE; which++)
        outcome = link_crossings(room, sides[which].edges, which, tolerance);
    if (outcome != DONE)
        return outcome;
    const int fits = add_joined_rings(room, sides) && add_whole_rings(room, &sides[0], &sides[1])
                     && add_whole_rings(room, &sides[1], &sides[0]);
    return fits ? DONE : NO_MEMORY;
}

/* --- measures ----------------------------------------------------------------------------- */

/* Return twice the area that a ring encloses, positive where it runs counter-clockwise. */
static inline double doubled_area(const double *points, size_t count)
{
    double area = 0.0;
    for (size_t vertex = 1; vertex + 1 < count; vertex++)
        area += cross(points, points + 2 * vertex, points + 2 * vertex + 2);
    return area;
}

/* Add a ring's area to one, and let a box grow until it holds the ring. */
static inline void measure_ring(const Regions *regions, int64_t ring, double *area, Box *box)
{
    const int64_t begin = regions->rings[ring], end = regions->rings[ring + 1];
    *area += doubled_area(regions->points + 2 * begin, (size_t)(end - begin)) / 2;
    for (int64_t vertex = begin; vertex < end; vertex++)
        include(box, regions->points + 2 * vertex);
}

/* Measure the area and the box of a region. */
static inline void measure_region(const Regions *regions, int64_t region, double *area, Box *box)
{
    *area = 0.0;
    *box = EMPTY;
    for (int64_t ring = regions->regions[region]; ring < regions->regions[region + 1]; ring++)
        measure_ring(regions, ring, area, box);
}

/* --- Python ------------------------------------------------------------------------------- */

/* Tell whether all numbers are finite, and none so large that what comes of them is not. */
static inline int are_moderate(const Py_buffer *numbers)
{
    const double *values = numbers->buf;
    int64_t moderate = 1;
    for (Py_ssize_t place = 0; place < numbers->len / (Py_ssize_t)sizeof(double); place++)
        moderate &= fabs(values[place]) <= MOST; /* without leaving early: several at once */
    return moderate != 0;
}

static inline int are_regions(const Py_buffer *views, Regions *regions)
{
    regions->points = views[0].buf;
    regions->rings = views[1].buf;
    regions->regions = views[2].buf;
    regions->count = views[2].shape[0] - 1;
    return are_ends(&views[1], views[0].shape[0], 3)
           && are_ends(&views[2], views[1].shape[0] - 1, 0) && are_moderate(&views[0]);
}

static inline PyObject *reject(void)
{
    PyErr_SetString(PyExc_ValueError,
                    "Expected rings of three vertices or more, finite numbers up to 1e75, and "
                    "arrays that agree");
    return NULL;
}

static inline void free_room(Room *room)
{
    List *const lists = (List *)room; /* it is made of nothing else */
    for (size_t place = 0; place < sizeof(Room) / sizeof(List); place++)
        free(lists[place].items);
}

static inline void free_outline(Outline *outline)
{
    for (int list = 0; list < 3; list++)
        free(outline->memory[list].items);
    free(outline->cells.items);
    free(outline->entries.items);
}

#endif
