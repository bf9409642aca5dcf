/* Regions of many planes intersected with one outline each, where nothing is degenerate.
 *
 * Boundaries that cross away from their vertices are cut at the crossings and joined anew (K. Weiler
 * and P. Atherton, Hidden surface removal using polygon area sorting, 1977). A plane where a vertex
 * comes near the other boundary, where crossings lie upon each other, or where they do not alternate
 * between inward and outward is reported instead, for a library that also knows what to do there.
 */

#include "_arrays.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_STRIPS = 4096, EDGES_A_STRIP = 8 }; /* fewer strips cost more tests, more cost more entries */
enum { MOST_LEFT_OUT = 16 }; /* vertices one after the other: so that time stays linear */

/* Rings, one behind the other, and regions of rings, likewise; the inside is on their left. */
typedef struct {
    const double *points;   /* (n, 2) */
    const int64_t *rings;   /* (rings + 1,): where each begins, and where the last ends */
    const int64_t *regions; /* (regions + 1,): the first ring of each, and how many there are */
    Py_ssize_t count;       /* regions */
} Regions;

/* Memory that grows, for items of one size. */
typedef struct {
    void *items;
    size_t count, room, size;
} List;

/* One region, laid out for edges: edge i goes from vertex i to vertex next[i]. */
typedef struct {
    int64_t count, rings;
    double *points;       /* (count, 2) */
    int64_t *next, *ring; /* (count,) */
    int64_t *first;       /* (rings + 1,) */
    uint8_t *is_crossed;  /* (rings,) */
    double low[2], high[2];
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

typedef struct {
    List laid[2][4]; /* the arrays of both sides; these and the next are kept from plane to plane */
    List strips, entries, crossings, places;
    List points, rings, regions; /* results */
} Room;

typedef enum { DONE, DOUBTFUL, NO_MEMORY } Outcome;

static void *reserved(List *list, size_t count, size_t size)
{
    list->size = size;
    if (count > list->room || list->items == NULL) {
        const size_t room = count + count / 2 + 16;
        void *items = realloc(list->items, room * size);
        if (items == NULL)
            return NULL;
        list->items = items;
        list->room = room;
    }
    return list->items;
}

static void *appended(List *list, size_t size)
{
    if (reserved(list, list->count + 1, size) == NULL)
        return NULL;
    return (char *)list->items + size * list->count++;
}

static int add_point(Room *room, const double *point)
{
    double *place = appended(&room->points, 2 * sizeof(double));
    if (place != NULL)
        memcpy(place, point, 2 * sizeof(double));
    return place != NULL;
}

/* End a list of rings or regions at what has been counted so far. */
static int add_end(List *ends, size_t count)
{
    int64_t *end = appended(ends, sizeof(int64_t));
    if (end != NULL)
        *end = (int64_t)count;
    return end != NULL;
}

/* --- one side of a plane ------------------------------------------------------------------ */

/* Lay a region out, scaled and shifted; `memory` is four lists of the side's own. */
static int lay_out(Side *side, List *memory, const Regions *from, int64_t region, double scale,
                   const double *shift)
{
    const int64_t *rings = from->rings + from->regions[region];
    side->rings = from->regions[region + 1] - from->regions[region];
    side->count = rings[side->rings] - rings[0];
    const size_t count = (size_t)side->count, others = (size_t)side->rings + 1;
    side->points = reserved(&memory[0], count, 2 * sizeof(double));
    side->next = reserved(&memory[1], 2 * count, sizeof(int64_t));
    side->first = reserved(&memory[2], others, sizeof(int64_t));
    side->is_crossed = reserved(&memory[3], others, 1);
    if (!side->points || !side->next || !side->first || !side->is_crossed)
        return 0;
    side->ring = side->next + count;
    memset(side->is_crossed, 0, others);
    for (int axis = 0; axis < 2; axis++) {
        side->low[axis] = INFINITY;
        side->high[axis] = -INFINITY;
    }
    const double *points = from->points + 2 * rings[0];
    for (int64_t place = 0; place < 2 * side->count; place++) {
        const double value = scale * points[place] + shift[place & 1];
        side->points[place] = value;
        if (value < side->low[place & 1])
            side->low[place & 1] = value;
        if (value > side->high[place & 1])
            side->high[place & 1] = value;
    }
    for (int64_t ring = 0; ring < side->rings; ring++) {
        const int64_t begin = rings[ring] - rings[0], end = rings[ring + 1] - rings[0];
        side->first[ring] = begin;
        for (int64_t vertex = begin; vertex < end; vertex++) {
            side->next[vertex] = vertex + 1 < end ? vertex + 1 : begin;
            side->ring[vertex] = ring;
        }
    }
    side->first[side->rings] = side->count;
    return 1;
}

/* Return twice the area of a triangle: positive where the point is on the left of the edge. */
static double cross(const double *start, const double *end, const double *point)
{
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0]);
}

/* Tell whether a ray to the right from a point crosses an edge. */
static int is_passed(const double *start, const double *end, const double *point)
{
    if ((start[1] <= point[1]) == (end[1] <= point[1]))
        return 0;
    return (cross(start, end, point) > 0) == (end[1] > start[1]);
}

/* Tell whether a point lies inside a side. */
static int is_inside(const Side *side, const double *point)
{
    int inside = 0;
    for (int64_t edge = 0; edge < side->count; edge++)
        inside ^= is_passed(side->points + 2 * edge, side->points + 2 * side->next[edge], point);
    return inside;
}

/* Tell whether a point lies inside a region. */
static int region_holds(const Regions *regions, int64_t region, const double *point)
{
    int inside = 0;
    for (int64_t ring = regions->regions[region]; ring < regions->regions[region + 1]; ring++) {
        const double *start = regions->points + 2 * (regions->rings[ring + 1] - 1);
        const double *end = regions->points + 2 * regions->rings[ring];
        for (; end < regions->points + 2 * regions->rings[ring + 1]; start = end, end += 2)
            inside ^= is_passed(start, end, point);
    }
    return inside;
}

/* --- crossings ---------------------------------------------------------------------------- */

/* Tell whether a point beside a segment, by the cross product, comes near it. */
static int is_near(const double *start, const double *end, const double *point, double beside,
                   double length, double tolerance)
{
    if (fabs(beside) > tolerance * length)
        return 0;
    const double along = (end[0] - start[0]) * (point[0] - start[0])
                         + (end[1] - start[1]) * (point[1] - start[1]);
    return along >= -tolerance * length && along <= (length + tolerance) * length;
}

/* Look at an edge of each side; add their crossing if they have one. */
static Outcome cross_edges(Room *room, Side *const sides[2], const int64_t edges[2],
                           double tolerance)
{
    const double *start[2], *end[2];
    double before[2], after[2], length[2];
    for (int side = 0; side < 2; side++) {
        start[side] = sides[side]->points + 2 * edges[side];
        end[side] = sides[side]->points + 2 * sides[side]->next[edges[side]];
        length[side] = hypot(end[side][0] - start[side][0], end[side][1] - start[side][1]);
    }
    int is_clear = 1;
    for (int side = 0; side < 2; side++) { /* the ends of this side's edge beside the other's */
        const int other = !side;
        before[side] = cross(start[other], end[other], start[side]);
        after[side] = cross(start[other], end[other], end[side]);
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
            if (is_near(start[other], end[other], start[side], before[side], length[other], tolerance)
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
        sides[side]->is_crossed[sides[side]->ring[edges[side]]] = 1;
    }
    for (int axis = 0; axis < 2; axis++)
        crossing->point[axis] = start[0][axis] + crossing->at[0] * (end[0][axis] - start[0][axis]);
    crossing->enters = after[0] > 0;
    crossing->is_used = 0;
    return DONE;
}

static double lesser(double one, double other) { return one < other ? one : other; }
static double greater(double one, double other) { return one > other ? one : other; }

/* The box of an edge, grown by the tolerance. */
typedef struct {
    double low[2], high[2];
} Box;

static Box box_of(const Side *side, int64_t edge, double tolerance)
{
    const double *start = side->points + 2 * edge, *end = side->points + 2 * side->next[edge];
    Box box;
    for (int axis = 0; axis < 2; axis++) {
        box.low[axis] = lesser(start[axis], end[axis]) - tolerance;
        box.high[axis] = greater(start[axis], end[axis]) + tolerance;
    }
    return box;
}

static int boxes_meet(const double *low, const double *high, const Box *box)
{
    return (box->low[0] <= high[0]) & (low[0] <= box->high[0]) & (box->low[1] <= high[1])
           & (low[1] <= box->high[1]); /* all four: a branch at each would cost more */
}

typedef struct {
    Box box;
    int64_t edge, strip; /* the first strip that the edge meets */
} Entry;

/* Edges of a side, entered in the strips of equal height that they meet within a box. */
typedef struct {
    int64_t count;
    double low[2], high[2], per_unit;
    int64_t *ends; /* strip i has entries[ends[i]] up to entries[ends[i + 1]] */
    Entry *entries;
} Strips;

static int64_t strip_of(const Strips *strips, double y)
{
    const double strip = (y - strips->low[1]) * strips->per_unit;
    if (!(strip > 0))
        return 0;
    return strip >= (double)strips->count ? strips->count - 1 : (int64_t)strip;
}

static Outcome enter_edges(Room *room, Strips *strips, const Side *side, double tolerance)
{
    const size_t count = (size_t)strips->count;
    strips->ends = reserved(&room->strips, count + 2, sizeof(int64_t));
    if (strips->ends == NULL)
        return NO_MEMORY;
    memset(strips->ends, 0, (count + 2) * sizeof(int64_t));
    for (int enters = 0; enters < 2; enters++) { /* count them, then enter them */
        for (int64_t edge = 0; edge < side->count; edge++) {
            const Box box = box_of(side, edge, tolerance);
            if (!boxes_meet(strips->low, strips->high, &box))
                continue;
            const int64_t first = strip_of(strips, box.low[1]);
            const int64_t last = strip_of(strips, box.high[1]);
            for (int64_t strip = first; strip <= last; strip++) {
                if (enters)
                    strips->entries[strips->ends[strip + 1]++] = (Entry){box, edge, first};
                else
                    strips->ends[strip + 2]++;
            }
        }
        if (enters)
            break;
        for (size_t strip = 2; strip < count + 2; strip++)
            strips->ends[strip] += strips->ends[strip - 1];
        strips->entries = reserved(&room->entries, (size_t)strips->ends[count + 1], sizeof(Entry));
        if (strips->entries == NULL)
            return NO_MEMORY;
    }
    return DONE;
}

/* Find all crossings of two sides. */
static Outcome find_crossings(Room *room, Side *const sides[2], double tolerance)
{
    Strips strips;
    for (int axis = 0; axis < 2; axis++) {
        strips.low[axis] = greater(sides[0]->low[axis], sides[1]->low[axis]) - tolerance;
        strips.high[axis] = lesser(sides[0]->high[axis], sides[1]->high[axis]) + tolerance;
        if (strips.low[axis] > strips.high[axis])
            return DONE;
    }
    const int64_t wanted = sides[1]->count / EDGES_A_STRIP + 1;
    strips.count = wanted < MOST_STRIPS ? wanted : MOST_STRIPS;
    strips.per_unit = (double)strips.count / (strips.high[1] - strips.low[1]);
    Outcome outcome = enter_edges(room, &strips, sides[1], tolerance);
    for (int64_t edge = 0; edge < sides[0]->count && outcome == DONE; edge++) {
        const Box box = box_of(sides[0], edge, tolerance);
        if (!boxes_meet(strips.low, strips.high, &box))
            continue;
        const int64_t first = strip_of(&strips, box.low[1]), last = strip_of(&strips, box.high[1]);
        for (int64_t strip = first; strip <= last && outcome == DONE; strip++) {
            for (int64_t place = strips.ends[strip];
                 place < strips.ends[strip + 1] && outcome == DONE; place++) {
                const Entry *entry = &strips.entries[place];
                if (!boxes_meet(box.low, box.high, &entry->box))
                    continue;
                const int64_t edges[2] = {edge, entry->edge};
                if (strip == (entry->strip > first ? entry->strip : first)) /* the first of both */
                    outcome = cross_edges(room, sides, edges, tolerance);
            }
        }
    }
    return outcome;
}

static int in_order(const void *one, const void *other)
{
    const Place *first = one, *second = other;
    if (first->edge != second->edge)
        return first->edge < second->edge ? -1 : 1;
    return (first->at > second->at) - (first->at < second->at);
}

/* Find the crossing after each along one side's rings. */
static Outcome link_crossings(Room *room, const Side *side, int which, double tolerance)
{
    Crossing *crossings = room->crossings.items;
    const size_t count = room->crossings.count;
    Place *places = reserved(&room->places, count, sizeof(Place));
    if (places == NULL)
        return NO_MEMORY;
    for (size_t place = 0; place < count; place++)
        places[place] = (Place){crossings[place].edge[which], crossings[place].at[which],
                                (int64_t)place};
    qsort(places, count, sizeof(Place), in_order);
    size_t first = 0; /* of the ring */
    for (size_t place = 0; place < count; place++) {
        const int64_t ring = side->ring[places[place].edge];
        const int is_last = place + 1 == count || side->ring[places[place + 1].edge] != ring;
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

/* --- the result --------------------------------------------------------------------------- */

static int add_ring(Room *room, const Side *side, int64_t ring)
{
    for (int64_t vertex = side->first[ring]; vertex < side->first[ring + 1]; vertex++)
        if (!add_point(room, side->points + 2 * vertex))
            return 0;
    return add_end(&room->rings, room->points.count);
}

/* Add the rings of a side that cross nothing and lie inside the other side. */
static int add_whole_rings(Room *room, const Side *side, const Side *other)
{
    for (int64_t ring = 0; ring < side->rings; ring++)
        if (!side->is_crossed[ring] && is_inside(other, side->points + 2 * side->first[ring])
            && !add_ring(room, side, ring))
            return 0;
    return 1;
}

/* Add the vertices of a side after one crossing and before the next. */
static int add_part(Room *room, const Side *side, int which, const Crossing *from,
                    const Crossing *to)
{
    int64_t edge = from->edge[which];
    if (edge == to->edge[which] && from->at[which] < to->at[which])
        return 1;
    do {
        edge = side->next[edge];
        if (!add_point(room, side->points + 2 * edge))
            return 0;
    } while (edge != to->edge[which]);
    return 1;
}

/* Follow the first side inside the second one, and the second inside the first, in turn. */
static int add_joined_rings(Room *room, Side *const sides[2])
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
            if (!add_point(room, here->point) || !add_part(room, sides[which], which, here, next))
                return 0;
            here = next;
            which = !which;
        } while (here != &crossings[start]);
        if (!add_end(&room->rings, room->points.count))
            return 0;
    }
    return 1;
}

/* Intersect two sides. */
static Outcome intersect_sides(Room *room, Side *const sides[2], double tolerance)
{
    room->crossings.count = 0;
    Outcome outcome = find_crossings(room, sides, tolerance);
    for (int which = 0; which < 2 && outcome == DONE; which++)
        outcome = link_crossings(room, sides[which], which, tolerance);
    if (outcome != DONE)
        return outcome;
    const int fits = add_joined_rings(room, sides) && add_whole_rings(room, sides[0], sides[1])
                     && add_whole_rings(room, sides[1], sides[0]);
    return fits ? DONE : NO_MEMORY;
}

/* --- all planes --------------------------------------------------------------------------- */

typedef struct {
    Regions regions, outlines;
    Py_ssize_t steps;      /* outlines that each plane is clipped with, one after the other */
    const int64_t *chosen; /* (steps, planes): which */
    const double *scales;  /* (steps, planes) */
    const double *shifts;  /* (steps, planes, 2) */
    int64_t *done;         /* (planes,), in and out: the steps that a plane has behind it */
    double tolerance;
} Work;

/* Clip the region of one plane, step by step; stop before a step that is doubtful. */
static int clip_plane(const Work *work, Room *room, Py_ssize_t plane)
{
    static const double NOWHERE[2] = {0.0, 0.0};
    const size_t points = room->points.count, rings = room->rings.count - 1;
    Side first, second;
    Side *const sides[2] = {&first, &second};
    if (!lay_out(&first, room->laid[0], &work->regions, plane, 1.0, NOWHERE))
        return 0;
    Outcome outcome = DONE;
    for (int64_t *done = &work->done[plane]; *done < work->steps && first.rings; ++*done) {
        const Py_ssize_t at = *done * work->regions.count + plane;
        if (!lay_out(&second, room->laid[1], &work->outlines, work->chosen[at], work->scales[at],
                     work->shifts + 2 * at))
            return 0;
        outcome = intersect_sides(room, sides, work->tolerance);
        if (outcome != DONE)
            break;
        const int64_t all[2] = {0, (int64_t)(room->rings.count - 1 - rings)};
        const Regions result = {room->points.items, (int64_t *)room->rings.items + rings, all, 1};
        if (!lay_out(&first, room->laid[0], &result, 0, 1.0, NOWHERE))
            return 0;
        room->points.count = points;
        room->rings.count = rings + 1;
    }
    room->points.count = points;
    room->rings.count = rings + 1;
    for (int64_t ring = 0; ring < first.rings; ring++)
        if (!add_ring(room, &first, ring))
            return 0;
    if (!first.rings)
        work->done[plane] = work->steps;
    return outcome != NO_MEMORY && add_end(&room->regions, room->rings.count - 1);
}

/* Clip all; return whether the memory sufficed. */
static int clip_all(const Work *work, Room *room)
{
    if (!add_end(&room->rings, 0) || !add_end(&room->regions, 0))
        return 0;
    for (Py_ssize_t plane = 0; plane < work->regions.count; plane++)
        if (!clip_plane(work, room, plane))
            return 0;
    return 1;
}

/* --- simplification ----------------------------------------------------------------------- */

static double distance_squared(const double *start, const double *end, const double *point)
{
    const double span[2] = {end[0] - start[0], end[1] - start[1]};
    double away[2] = {point[0] - start[0], point[1] - start[1]};
    const double square = span[0] * span[0] + span[1] * span[1];
    double along = square > 0 ? (away[0] * span[0] + away[1] * span[1]) / square : 0.0;
    along = lesser(greater(along, 0.0), 1.0);
    for (int axis = 0; axis < 2; axis++)
        away[axis] -= along * span[axis];
    return away[0] * away[0] + away[1] * away[1];
}

/* Add a ring without the vertices that lie within a tolerance of the edge which that makes. */
static int add_simplified(Room *room, const double *points, int64_t count, double tolerance)
{
    const size_t begin = room->points.count;
    int64_t anchor = 0;
    if (!add_point(room, points))
        return 0;
    for (int64_t vertex = 1; vertex < count; vertex++) {
        const double *next = points + 2 * ((vertex + 1) % count);
        int stands_out = vertex - anchor > MOST_LEFT_OUT;
        for (int64_t passed = anchor + 1; passed <= vertex && !stands_out; passed++)
            stands_out = distance_squared(points + 2 * anchor, next, points + 2 * passed)
                         > tolerance * tolerance;
        if (!stands_out)
            continue;
        if (!add_point(room, points + 2 * vertex))
            return 0;
        anchor = vertex;
    }
    if (room->points.count < begin + 3) {
        room->points.count = begin;
        return 1;
    }
    return add_end(&room->rings, room->points.count);
}

static int simplify_all(const Regions *regions, double tolerance, Room *room)
{
    if (!add_end(&room->rings, 0) || !add_end(&room->regions, 0))
        return 0;
    for (Py_ssize_t region = 0; region < regions->count; region++) {
        for (int64_t ring = regions->regions[region]; ring < regions->regions[region + 1]; ring++) {
            const int64_t begin = regions->rings[ring], end = regions->rings[ring + 1];
            if (!add_simplified(room, regions->points + 2 * begin, end - begin, tolerance))
                return 0;
        }
        if (!add_end(&room->regions, room->rings.count - 1))
            return 0;
    }
    return 1;
}

static void free_room(Room *room)
{
    List *const lists = (List *)room;
    for (size_t place = 0; place < sizeof(Room) / sizeof(List); place++)
        free(lists[place].items);
}

/* --- Python ------------------------------------------------------------------------------- */

enum {
    POINTS, RINGS, REGIONS, OUTLINE_POINTS, OUTLINE_RINGS, OUTLINE_REGIONS,
    CHOSEN, SCALES, SHIFTS, DONE_STEPS, ARRAYS
};

static const ArrayKind KINDS[ARRAYS] = {
    {"points", 'd', 2, 0},         {"rings", 'q', 0, 0},         {"regions", 'q', 0, 0},
    {"outline points", 'd', 2, 0}, {"outline rings", 'q', 0, 0}, {"outline regions", 'q', 0, 0},
    {"chosen", 'q', 0, 0},         {"scales", 'd', 0, 0},        {"shifts", 'd', 2, 0},
    {"done", 'q', 0, 1},
};

enum { HELD_CHOSEN = OUTLINE_POINTS, HELD_POINTS, IS_HELD, HELD_ARRAYS };

static const ArrayKind HELD_KINDS[HELD_ARRAYS] = {
    {"points", 'd', 2, 0}, {"rings", 'q', 0, 0}, {"regions", 'q', 0, 0},
    {"chosen", 'q', 0, 0}, {"held points", 'd', 2, 0}, {"is_held", '?', 0, 1},
};

/* Tell whether numbers increase from 0 to a last one, each by so much at the least. */
static int are_ends(const Py_buffer *ends, int64_t last, int64_t least)
{
    const int64_t *values = ends->buf;
    const Py_ssize_t count = ends->shape[0];
    if (count < 1 || values[0] != 0 || values[count - 1] != last)
        return 0;
    for (Py_ssize_t place = 1; place < count; place++)
        if (values[place] < values[place - 1] + least)
            return 0;
    return 1;
}

static int are_finite(const Py_buffer *numbers)
{
    const double *values = numbers->buf;
    for (Py_ssize_t place = 0; place < numbers->len / (Py_ssize_t)sizeof(double); place++)
        if (!isfinite(values[place]))
            return 0;
    return 1;
}

static int are_regions(const Py_buffer *views, Regions *regions)
{
    regions->points = views[0].buf;
    regions->rings = views[1].buf;
    regions->regions = views[2].buf;
    regions->count = views[2].shape[0] - 1;
    return are_ends(&views[1], views[0].shape[0], 3)
           && are_ends(&views[2], views[1].shape[0] - 1, 0) && are_finite(&views[0]);
}

static int is_consistent(const Py_buffer *views, Work *work)
{
    int good = are_regions(views + POINTS, &work->regions)
               && are_regions(views + OUTLINE_POINTS, &work->outlines)
               && are_finite(&views[SCALES]) && are_finite(&views[SHIFTS]);
    const Py_ssize_t planes = work->regions.count, places = views[CHOSEN].shape[0];
    work->steps = planes > 0 ? places / planes : 0;
    good = good && places == work->steps * planes && views[SCALES].shape[0] == places
           && views[SHIFTS].shape[0] == places && views[DONE_STEPS].shape[0] == planes;
    work->chosen = views[CHOSEN].buf;
    work->scales = views[SCALES].buf;
    work->shifts = views[SHIFTS].buf;
    work->done = views[DONE_STEPS].buf;
    for (Py_ssize_t place = 0; good && place < places; place++)
        good = work->chosen[place] >= 0 && work->chosen[place] < work->outlines.count;
    for (Py_ssize_t plane = 0; good && plane < planes; plane++)
        good = work->done[plane] >= 0;
    return good;
}

static PyObject *bytes_of(const List *list)
{
    return PyBytes_FromStringAndSize(list->items, (Py_ssize_t)(list->count * list->size));
}

/* Return the regions of a room and empty it, or raise a MemoryError. */
static PyObject *result_of(Room *room, int fits)
{
    PyObject *result = fits ? Py_BuildValue("NNN", bytes_of(&room->points), bytes_of(&room->rings),
                                            bytes_of(&room->regions))
                            : PyErr_NoMemory();
    free_room(room);
    return result;
}

/* Get arrays, and a tolerance after them; return 0 with an error set if that fails. */
static int get_all(PyObject *const *arguments, Py_ssize_t given, int count, Py_buffer *views,
                   double *tolerance)
{
    *tolerance = given == count + 1 ? PyFloat_AsDouble(arguments[count]) : 0.0;
    return !PyErr_Occurred() && get_arrays(arguments, given - 1, KINDS, count, views);
}

static PyObject *reject(void)
{
    PyErr_SetString(PyExc_ValueError,
                    "Expected finite rings of three vertices or more, and arrays that agree");
    return NULL;
}

static PyObject *clip(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[ARRAYS];
    Work work;
    if (!get_all(arguments, count, ARRAYS, views, &work.tolerance))
        return NULL;
    PyObject *result;
    if (is_consistent(views, &work)) {
        Room room = {0};
        int fits;
        Py_BEGIN_ALLOW_THREADS
        fits = clip_all(&work, &room);
        Py_END_ALLOW_THREADS
        result = result_of(&room, fits);
    } else {
        result = reject();
    }
    release_arrays(views, ARRAYS);
    return result;
}

static PyObject *hold(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[HELD_ARRAYS];
    Regions regions;
    if (!get_arrays(arguments, count, HELD_KINDS, HELD_ARRAYS, views))
        return NULL;
    int good = are_regions(views, &regions);
    const int64_t *chosen = views[HELD_CHOSEN].buf;
    const double *points = views[HELD_POINTS].buf;
    uint8_t *is_held = views[IS_HELD].buf;
    const Py_ssize_t places = views[HELD_CHOSEN].shape[0];
    good = good && views[HELD_POINTS].shape[0] == places && views[IS_HELD].shape[0] == places;
    for (Py_ssize_t place = 0; good && place < places; place++)
        good = chosen[place] >= 0 && chosen[place] < regions.count;
    for (Py_ssize_t place = 0; good && place < places; place++)
        is_held[place] = (uint8_t)region_holds(&regions, chosen[place], points + 2 * place);
    release_arrays(views, HELD_ARRAYS);
    if (!good)
        return reject();
    Py_RETURN_NONE;
}

static PyObject *simplify(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[OUTLINE_POINTS];
    Regions regions;
    double tolerance;
    if (!get_all(arguments, count, OUTLINE_POINTS, views, &tolerance))
        return NULL;
    PyObject *result;
    if (are_regions(views, &regions)) {
        Room room = {0};
        int fits;
        Py_BEGIN_ALLOW_THREADS
        fits = simplify_all(&regions, tolerance, &room);
        Py_END_ALLOW_THREADS
        result = result_of(&room, fits);
    } else {
        result = reject();
    }
    release_arrays(views, OUTLINE_POINTS);
    return result;
}

static PyMethodDef METHODS[] = {
    {"clip", (PyCFunction)(void (*)(void))clip, METH_FASTCALL,
     "Clip the region of each plane with outlines, scaled and shifted, one after the other."},
    {"hold", (PyCFunction)(void (*)(void))hold, METH_FASTCALL,
     "Tell for points whether the region of each, chosen among some, holds it."},
    {"simplify", (PyCFunction)(void (*)(void))simplify, METH_FASTCALL,
     "Leave out vertices that lie within a tolerance of the edge which that makes."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "_clipping", .m_size = 0, .m_methods = METHODS,
};

PyMODINIT_FUNC PyInit__clipping(void)
{
    return PyModuleDef_Init(&MODULE);
}
