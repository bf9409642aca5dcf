/* Regions of many planes clipped with outlines, simplified, taken apart and measured. */

#include "_clipping.h"
#include "_module.h"

enum { MOST_LEFT_OUT = 16 }; /* vertices one after the other: so that time stays linear */

/* --- all planes --------------------------------------------------------------------------- */

/* What planes are clipped with in one step: an outline each, scaled and shifted. */
typedef struct {
    Regions regions;
    Outline *outlines;     /* of the regions, laid out when they are first needed */
    const int64_t *chosen; /* (planes,): which */
    const double *scales;  /* (planes,) */
    const double *shifts;  /* (planes, 2) */
} Step;

typedef struct {
    Regions regions;
    Step *steps; /* one after the other */
    Py_ssize_t count;
    int64_t *done; /* (planes,), in and out: the steps that a plane has behind it */
    double tolerance;
} Work;

/* Return the outline that a plane is clipped with in a step. */
static const Outline *outline_of(const Step *step, Py_ssize_t plane)
{
    const int64_t which = step->chosen[plane];
    Outline *outline = &step->outlines[which];
    if (!outline->is_laid)
        outline->is_laid = lay_out(&outline->edges, outline->memory, &step->regions, which)
                           && enter_edges(outline);
    return outline->is_laid ? outline : NULL;
}

/* Add rings of any regions as they are, from one to another. */
static int add_rings(Room *room, const Regions *from, int64_t first, int64_t last)
{
    const int64_t *ends = from->rings + first;
    const size_t begin = room->points.count, count = (size_t)(from->rings[last] - *ends);
    double *copied = reserved(&room->points, begin + count, 2 * sizeof(double));
    if (copied == NULL)
        return 0;
    if (count > 0) /* else there may be no points at all, nowhere to copy them from */
        memcpy(copied + 2 * begin, from->points + 2 * *ends, 2 * count * sizeof(double));
    room->points.count += count;
    for (int64_t ring = 0; ring < last - first; ring++)
        if (!add_end(&room->rings, begin + (size_t)(ends[ring + 1] - *ends)))
            return 0;
    return 1;
}

/* Add a region as it is. */
static int add_region(Room *room, const Regions *from, int64_t region)
{
    const int64_t *rings = from->regions + region;
    return add_rings(room, from, rings[0], rings[1])
           && add_end(&room->regions, room->rings.count - 1);
}

/* Clip the region of one plane in a step; leave the room as it was if that is doubtful. */
static Outcome clip_plane(const Work *work, Room *room, const Regions *from, const Step *step,
                          Py_ssize_t plane)
{
    const size_t points = room->points.count, ends = room->rings.count;
    const Outline *outline = outline_of(step, plane);
    Edges region;
    if (outline == NULL || !lay_out(&region, room->memory, from, plane))
        return NO_MEMORY;
    Side sides[2] = {{.edges = &region, .scale = 1.0, .shift = NOWHERE},
                     {&outline->edges, step->scales[plane], step->shifts + 2 * plane, NULL}};
    const Outcome outcome = intersect(room, sides, outline, work->tolerance);
    if (outcome != DONE) {
        room->points.count = points;
        room->rings.count = ends;
    }
    return outcome;
}

/* Clip the regions of the planes that are due for a step; the others stay as they are. */
static int clip_step(const Work *work, Room *room, const Regions *from, Py_ssize_t number)
{
    for (Py_ssize_t plane = 0; plane < from->count; plane++) {
        const int64_t *rings = from->regions + plane;
        Outcome outcome = DOUBTFUL;
        if (work->done[plane] == number && rings[0] == rings[1])
            work->done[plane] = work->count;
        else if (work->done[plane] == number)
            outcome = clip_plane(work, room, from, &work->steps[number], plane);
        work->done[plane] += outcome == DONE;
        if (outcome == NO_MEMORY
            || (outcome == DOUBTFUL && !add_region(room, from, plane))
            || (outcome == DONE && !add_end(&room->regions, room->rings.count - 1)))
            return 0;
    }
    return 1;
}

/* Lay the results aside, to be clipped further; return them. */
static Regions laid_aside(Room *room)
{
    List *const results[RESULTS] = {&room->points, &room->rings, &room->regions};
    for (int list = 0; list < RESULTS; list++) {
        const List emptied = room->before[list];
        room->before[list] = *results[list];
        *results[list] = emptied;
        results[list]->count = 0;
    }
    return (Regions){room->before[0].items, room->before[1].items, room->before[2].items,
                     (Py_ssize_t)room->before[2].count - 1};
}

/* Tell whether any plane is due for a step. */
static int is_due(const Work *work, Py_ssize_t number)
{
    Py_ssize_t plane = 0;
    while (plane < work->regions.count && work->done[plane] != number)
        plane++;
    return plane < work->regions.count;
}

static void free_outlines(Step *step)
{
    for (Py_ssize_t which = 0; step->outlines && which < step->regions.count; which++)
        free_outline(&step->outlines[which]);
    free(step->outlines);
}

/* Clip all; return whether the memory sufficed.
 *
 * All planes take one step before the next: what an outline is looked up in stays in the cache.
 */
static int clip_all(const Work *work, Room *room)
{
    int fits = begin_results(room);
    for (Py_ssize_t plane = 0; fits && plane < work->regions.count; plane++)
        fits = add_region(room, &work->regions, plane);
    for (Py_ssize_t number = 0; fits && number < work->count; number++) {
        if (!is_due(work, number))
            continue;
        const Regions from = laid_aside(room);
        Step *step = &work->steps[number];
        step->outlines = calloc((size_t)step->regions.count + 1, sizeof(Outline));
        fits = step->outlines != NULL && begin_results(room)
               && clip_step(work, room, &from, number);
        free_outlines(step);
    }
    return fits;
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
    const size_t left = room->points.count - begin;
    const double area = doubled_area((double *)room->points.items + 2 * begin, left);
    if (left < 3 || fabs(area) <= tolerance * tolerance
        || (area > 0) != (doubled_area(points, (size_t)count) > 0)) {
        room->points.count = begin; /* thinner than the tolerance, or even turned over */
        return 1;
    }
    return add_end(&room->rings, room->points.count);
}

static int simplify_all(const Regions *regions, double tolerance, Room *room)
{
    if (!begin_results(room))
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

/* --- choice ------------------------------------------------------------------------------- */

/* Add some regions as they are. */
static int add_chosen(const Regions *from, const int64_t *chosen, Py_ssize_t count, Room *room)
{
    int fits = begin_results(room);
    for (Py_ssize_t place = 0; fits && place < count; place++)
        fits = add_region(room, from, chosen[place]);
    return fits;
}

/* --- pieces ------------------------------------------------------------------------------- */

/* What a ring encloses: a shell where the area is positive, else a hole. */
typedef struct {
    double area;
    Box box;
    int64_t next; /* a shell's first hole, and after each hole the next one of that shell; or -1 */
} Enclosed;

/* Tell whether most of a ring's vertices lie inside another ring. */
static int is_mostly_inside(const Regions *regions, int64_t ring, int64_t other, const Box *box)
{
    const int64_t *ends = regions->rings + ring;
    int64_t inside = 0;
    for (int64_t vertex = ends[0]; vertex < ends[1]; vertex++) {
        const double *point = regions->points + 2 * vertex;
        inside += point[0] >= box->low[0] && point[0] <= box->high[0] && point[1] >= box->low[1]
                  && point[1] <= box->high[1]
                  && is_bounded(regions->points, regions->rings + other, 1, point);
    }
    return 2 * inside >= ends[1] - ends[0];
}

/* Find the smallest shell of a region around a hole, or the smallest one if none is. */
static int64_t find_shell(const Regions *regions, const Enclosed *rings, const int64_t ends[2],
                          int64_t hole)
{
    int64_t best = -1;
    int is_around = 0;
    for (int64_t ring = ends[0]; ring < ends[1]; ring++) {
        const int is_smaller = best < 0 || rings[ring].area < rings[best].area;
        if (!(rings[ring].area > 0) || (is_around && !is_smaller))
            continue;
        const int holds = boxes_meet(&rings[ring].box, &rings[hole].box)
                          && is_mostly_inside(regions, hole, ring, &rings[ring].box);
        if (holds == is_around ? is_smaller : holds)
            best = ring;
        is_around |= holds;
    }
    return best;
}

/* Add the pieces of one region: each shell, then its holes; holes of no shell are left out. */
static int add_pieces(const Regions *regions, Enclosed *rings, const int64_t ends[2], Room *room)
{
    int64_t shells = 0, only = -1;
    for (int64_t ring = ends[0]; ring < ends[1]; ring++) {
        if (rings[ring].area > 0) {
            shells++;
            only = ring;
        }
    }
    for (int64_t ring = ends[1] - 1; ring >= ends[0]; ring--) { /* so that the first comes first */
        if (rings[ring].area > 0)
            continue;
        const int64_t shell = shells > 1 ? find_shell(regions, rings, ends, ring) : only;
        if (shell >= 0) {
            rings[ring].next = rings[shell].next;
            rings[shell].next = ring;
        }
    }
    for (int64_t shell = ends[0]; shell < ends[1]; shell++) {
        if (!(rings[shell].area > 0))
            continue;
        for (int64_t ring = shell; ring >= 0; ring = rings[ring].next)
            if (!add_rings(room, regions, ring, ring + 1))
                return 0;
        if (!add_end(&room->regions, room->rings.count - 1))
            return 0;
    }
    return 1;
}

/* Take regions apart; count where the pieces of each region end. */
static int take_apart(const Regions *regions, Enclosed *rings, int64_t *ends, Room *room)
{
    if (!begin_results(room))
        return 0;
    for (int64_t ring = 0; ring < regions->regions[regions->count]; ring++) {
        rings[ring] = (Enclosed){0.0, EMPTY, -1};
        measure_ring(regions, ring, &rings[ring].area, &rings[ring].box);
    }
    ends[0] = 0;
    for (Py_ssize_t region = 0; region < regions->count; region++) {
        if (!add_pieces(regions, rings, regions->regions + region, room))
            return 0;
        ends[region + 1] = (int64_t)room->regions.count - 1;
    }
    return 1;
}

/* --- Python ------------------------------------------------------------------------------- */

enum { POINTS, RINGS, REGIONS, DONE_STEPS, ARRAYS, FOOTPRINTS = ARRAYS, TOLERANCE, ARGUMENTS };

static const ArrayKind KINDS[ARRAYS] = {
    {"points", 'd', 2, 0}, {"rings", 'q', 0, 0}, {"regions", 'q', 0, 0}, {"done", 'q', 0, 1},
};

enum { REGION_ARRAYS = DONE_STEPS }; /* of any regions */

enum { CHOSEN = REGION_ARRAYS, SCALES, SHIFTS, STEP_ARRAYS };

static const ArrayKind STEP_KINDS[STEP_ARRAYS] = {
    {"outline points", 'd', 2, 0}, {"outline rings", 'q', 0, 0}, {"outline regions", 'q', 0, 0},
    {"chosen", 'q', 0, 0},         {"scales", 'd', 0, 0},        {"shifts", 'd', 2, 0},
};

enum { AREAS = REGION_ARRAYS, BOXES, MEASURED_ARRAYS };

static const ArrayKind MEASURED_KINDS[MEASURED_ARRAYS] = {
    {"points", 'd', 2, 0}, {"rings", 'q', 0, 0}, {"regions", 'q', 0, 0},
    {"areas", 'd', 0, 1},  {"boxes", 'd', 4, 1},
};

enum { ENDS = REGION_ARRAYS, TAKEN_ARRAYS };

static const ArrayKind TAKEN_KINDS[TAKEN_ARRAYS] = {
    {"points", 'd', 2, 0}, {"rings", 'q', 0, 0}, {"regions", 'q', 0, 0}, {"ends", 'q', 0, 1},
};

enum { CHOSEN_REGIONS = REGION_ARRAYS, CHOSEN_ARRAYS };

static const ArrayKind CHOSEN_KINDS[CHOSEN_ARRAYS] = {
    {"points", 'd', 2, 0}, {"rings", 'q', 0, 0}, {"regions", 'q', 0, 0}, {"chosen", 'q', 0, 0},
};

/* Take over the arrays of a step; return whether they agree. */
static int is_step(const Py_buffer *views, Py_ssize_t planes, Step *step)
{
    int good = are_regions(views, &step->regions) && are_moderate(&views[SCALES])
               && are_moderate(&views[SHIFTS]) && views[CHOSEN].shape[0] == planes
               && views[SCALES].shape[0] == planes && views[SHIFTS].shape[0] == planes
               && are_within(views[CHOSEN].buf, planes, step->regions.count);
    step->chosen = views[CHOSEN].buf;
    step->scales = views[SCALES].buf;
    step->shifts = views[SHIFTS].buf;
    for (Py_ssize_t plane = 0; good && plane < planes; plane++)
        good = step->scales[plane] >= 1 / MOST;
    return good;
}

/* Take over the arrays of all steps as well; return whether they agree. */
static int is_consistent(const Py_buffer *views, const Py_buffer *step_views, Work *work)
{
    int good = are_regions(views, &work->regions) && work->tolerance >= 0
               && work->tolerance <= MOST && views[DONE_STEPS].shape[0] == work->regions.count;
    work->done = views[DONE_STEPS].buf;
    for (Py_ssize_t plane = 0; good && plane < work->regions.count; plane++)
        good = work->done[plane] >= 0;
    for (Py_ssize_t array = 0; good && array < work->count * STEP_ARRAYS; array++)
        good = !do_overlap(&views[DONE_STEPS], &step_views[array]);
    for (Py_ssize_t step = 0; good && step < work->count; step++)
        good = is_step(step_views + step * STEP_ARRAYS, work->regions.count, &work->steps[step]);
    return good;
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

/* Clip with arrays that have been got; return NULL with an error set if that fails. */
static PyObject *clipped(const Py_buffer *views, const Py_buffer *step_views, Work *work)
{
    Room room = {0};
    int fits;
    work->steps = PyMem_Calloc((size_t)work->count + 1, sizeof(Step));
    if (work->steps == NULL)
        return PyErr_NoMemory();
    if (!is_consistent(views, step_views, work)) {
        PyMem_Free(work->steps);
        return reject();
    }
    Py_BEGIN_ALLOW_THREADS
    fits = clip_all(work, &room);
    Py_END_ALLOW_THREADS
    PyMem_Free(work->steps);
    return result_of(&room, fits);
}

static PyObject *clip(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[ARRAYS];
    if (count != ARGUMENTS)
        return PyErr_Format(PyExc_TypeError, "Expected %d arguments, got %zd", ARGUMENTS, count);
    Work work = {.tolerance = PyFloat_AsDouble(arguments[TOLERANCE])};
    if (PyErr_Occurred() || !get_arrays(arguments, ARRAYS, KINDS, ARRAYS, views))
        return NULL;
    PyObject *result = NULL;
    Py_buffer *step_views = get_tables(arguments[FOOTPRINTS], STEP_KINDS, STEP_ARRAYS);
    if (step_views != NULL) {
        work.count = PyTuple_GET_SIZE(arguments[FOOTPRINTS]);
        result = clipped(views, step_views, &work);
        release_tables(step_views, work.count, STEP_ARRAYS);
    }
    release_arrays(views, ARRAYS);
    return result;
}

static PyObject *measure(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[MEASURED_ARRAYS];
    Regions regions;
    if (!get_arrays(arguments, count, MEASURED_KINDS, MEASURED_ARRAYS, views))
        return NULL;
    const int good = are_regions(views, &regions) && views[AREAS].shape[0] == regions.count
                     && views[BOXES].shape[0] == regions.count;
    for (Py_ssize_t region = 0; good && region < regions.count; region++)
        measure_region(&regions, region, (double *)views[AREAS].buf + region,
                       (Box *)views[BOXES].buf + region);
    release_arrays(views, MEASURED_ARRAYS);
    if (!good)
        return reject();
    Py_RETURN_NONE;
}

static PyObject *simplify(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[REGION_ARRAYS];
    Regions regions;
    const double tolerance = count > 0 ? PyFloat_AsDouble(arguments[count - 1]) : 0.0;
    if (PyErr_Occurred() || !get_arrays(arguments, count - 1, KINDS, REGION_ARRAYS, views))
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
    release_arrays(views, REGION_ARRAYS);
    return result;
}

static PyObject *take(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[CHOSEN_ARRAYS];
    Regions regions;
    if (!get_arrays(arguments, count, CHOSEN_KINDS, CHOSEN_ARRAYS, views))
        return NULL;
    PyObject *result;
    const int64_t *chosen = views[CHOSEN_REGIONS].buf;
    const Py_ssize_t chosen_count = views[CHOSEN_REGIONS].shape[0];
    if (are_regions(views, &regions) && are_within(chosen, chosen_count, regions.count)) {
        Room room = {0};
        int fits;
        Py_BEGIN_ALLOW_THREADS
        fits = add_chosen(&regions, chosen, chosen_count, &room);
        Py_END_ALLOW_THREADS
        result = result_of(&room, fits);
    } else {
        result = reject();
    }
    release_arrays(views, CHOSEN_ARRAYS);
    return result;
}

static PyObject *apart(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[TAKEN_ARRAYS];
    Regions regions;
    if (!get_arrays(arguments, count, TAKEN_KINDS, TAKEN_ARRAYS, views))
        return NULL;
    PyObject *result;
    if (are_regions(views, &regions) && views[ENDS].shape[0] == regions.count + 1) {
        Room room = {0};
        int fits;
        Py_BEGIN_ALLOW_THREADS
        Enclosed *rings = calloc((size_t)views[RINGS].shape[0], sizeof(Enclosed));
        fits = rings != NULL && take_apart(&regions, rings, views[ENDS].buf, &room);
        free(rings);
        Py_END_ALLOW_THREADS
        result = result_of(&room, fits);
    } else {
        result = reject();
    }
    release_arrays(views, TAKEN_ARRAYS);
    return result;
}

static PyMethodDef METHODS[] = {
    METHOD(clip,
           "Clip the region of each plane with outlines, scaled and shifted, one after the other."),
    METHOD(take, "Return some of the regions."),
    METHOD(apart, "Take regions apart into connected pieces, and tell where each region's begin."),
    METHOD(measure, "Measure regions: areas and boxes."),
    METHOD(simplify,
           "Leave out vertices that lie within a tolerance of the edge which that makes."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_clipping)
