/* Which parts of lines of sight bound the visual hull: those in just enough viewing volumes.
 *
 * A line of sight of one view is a line in the image of every other; where that crosses the
 * outline there, the line of sight enters or leaves the other viewing volume (W. Matusik et al.,
 * Image-based visual hulls, 2000).
 */

#include "_lists.h"
#include "_module.h"
#include "_sorting.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

typedef struct {
    const double *points;     /* (vertices, 2), of the outlines in their images */
    const int64_t *rings;     /* (rings + 1,): where each begins, and where the last ends */
    const int64_t *outlines;  /* (views + 1,): the first ring of each view */
    const double *matrices;   /* (views, 3, 4): homogeneous image from world */
    const double *origins;    /* (rays, 3) */
    const double *directions; /* (rays, 3) */
    const int64_t *views;     /* (rays,): the view of each line of sight */
    Py_ssize_t view_count, ring_count, ray_count;
    int64_t spare;     /* volumes that a part may be outside of */
    double point_sine; /* below it, a line of sight is seen as a point */
} Work;

/* Where a line of sight enters a volume (step 1) or leaves one (-1), in its direction's lengths. */
typedef struct {
    double position;
    int step;
} Event;

/* A line of sight in an image: homogeneous, from a point along a slope. */
typedef struct {
    double start[3], slope[3], line[3];
} Sight;

typedef struct {
    Event *events; /* of one line of sight */
    size_t events_count;
    List rays, ends; /* results */
} Room;

static double length_of(const double *vector)
{
    return sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]);
}

/* See a line of sight in a view; tell whether it is seen as a line. */
static int see(const Work *work, Py_ssize_t ray, Py_ssize_t view, Sight *sight)
{
    const double *origin = work->origins + 3 * ray, *direction = work->directions + 3 * ray;
    for (int axis = 0; axis < 3; axis++) {
        const double *row = work->matrices + 12 * view + 4 * axis;
        sight->start[axis] = row[0] * origin[0] + row[1] * origin[1] + row[2] * origin[2] + row[3];
        sight->slope[axis] = row[0] * direction[0] + row[1] * direction[1] + row[2] * direction[2];
    }
    const double *start = sight->start, *slope = sight->slope;
    for (int axis = 0; axis < 3; axis++) {
        const int next = (axis + 1) % 3, last = (axis + 2) % 3;
        sight->line[axis] = start[next] * slope[last] - start[last] * slope[next];
    }
    return length_of(sight->line) > work->point_sine * length_of(start) * length_of(slope);
}

/* Note where a sight meets a point of its line, unless that lies behind the camera. */
static void meet(Room *room, const Sight *sight, double x, double y)
{
    const double *start = sight->start, *slope = sight->slope;
    const double offset[2] = {start[0] - start[2] * x, start[1] - start[2] * y};
    const double change[2] = {slope[0] - slope[2] * x, slope[1] - slope[2] * y};
    const double square = change[0] * change[0] + change[1] * change[1];
    if (!(square > 0)) /* where the line vanishes */
        return;
    const double position = -(offset[0] * change[0] + offset[1] * change[1]) / square;
    if (start[2] + position * slope[2] > 0)
        room->events[room->events_count++].position = position;
}

/* Note where a sight crosses a ring. */
static void cross_ring(const Work *work, Room *room, const Sight *sight, int64_t ring)
{
    const double *end = work->points + 2 * work->rings[ring + 1], *line = sight->line;
    const double *there = work->points + 2 * work->rings[ring], *here = end - 2;
    if (there == end)
        return;
    double side = line[0] * here[0] + line[1] * here[1] + line[2];
    for (; there < end; here = there, there += 2) {
        const double next = line[0] * there[0] + line[1] * there[1] + line[2];
        if ((side > 0) != (next > 0)) {
            const double along = side / (side - next);
            meet(room, sight, here[0] + along * (there[0] - here[0]),
                 here[1] + along * (there[1] - here[1]));
        }
        side = next;
    }
}

static int in_order(const void *one, const void *other)
{
    const Event *first = one, *second = other;
    if (first->position != second->position)
        return first->position < second->position ? -1 : 1;
    return first->step - second->step; /* out before in: touching volumes have no part in common */
}

/* Find the events of a line of sight with one other view's volume, entering and leaving in turn. */
static void cross_volume(const Work *work, Room *room, const Sight *sight, Py_ssize_t view)
{
    const size_t begin = room->events_count;
    for (int64_t ring = work->outlines[view]; ring < work->outlines[view + 1]; ring++)
        cross_ring(work, room, sight, ring);
    if ((room->events_count - begin) % 2) /* inside where the line vanishes */
        room->events[room->events_count++].position = copysign(INFINITY, sight->slope[2]);
    for (size_t event = begin; event < room->events_count; event++)
        room->events[event].step = 0;
    sort_items(room->events + begin, room->events_count - begin, sizeof(Event), in_order);
    for (size_t event = begin; event < room->events_count; event++)
        room->events[event].step = (event - begin) % 2 ? -1 : 1;
}

static int add_part(Room *room, int64_t ray, double low, double high)
{
    int64_t *owner = appended(&room->rays, sizeof(int64_t));
    double *ends = appended(&room->ends, 2 * sizeof(double));
    if (owner == NULL || ends == NULL)
        return 0;
    *owner = ray;
    ends[0] = low;
    ends[1] = high;
    return 1;
}

/* Add the parts of one line of sight that are in just enough of the other volumes. */
static int bound_ray(const Work *work, Room *room, Py_ssize_t ray)
{
    int64_t enough = -work->spare, inside = 0;
    room->events_count = 0;
    for (Py_ssize_t view = 0; view < work->view_count; view++) {
        Sight sight;
        if (view == work->views[ray] || !see(work, ray, view, &sight))
            continue;
        enough++;
        cross_volume(work, room, &sight, view);
    }
    sort_items(room->events, room->events_count, sizeof(Event), in_order);
    for (size_t event = 0; event + 1 < room->events_count; event++) {
        const double low = room->events[event].position, high = room->events[event + 1].position;
        inside += room->events[event].step;
        if (inside == enough && isfinite(low) && isfinite(high) && !add_part(room, ray, low, high))
            return 0;
    }
    return 1;
}

/* Bound all; return whether the memory sufficed. */
static int bound_all(const Work *work, Room *room)
{
    const size_t vertices = (size_t)work->rings[work->ring_count];
    room->events = malloc((vertices + (size_t)work->view_count + 1) * sizeof(Event));
    int fits = room->events != NULL;
    for (Py_ssize_t ray = 0; fits && ray < work->ray_count; ray++)
        fits = bound_ray(work, room, ray);
    return fits;
}

/* --- from and to Python ------------------------------------------------------------------- */

enum { POINTS, RINGS, OUTLINES, MATRICES, ORIGINS, DIRECTIONS, VIEWS, ARRAYS, SPARE = ARRAYS, SINE,
       ARGUMENTS };

static const ArrayKind KINDS[ARRAYS] = {
    {"points", 'd', 2, 0},   {"rings", 'q', 0, 0},   {"outlines", 'q', 0, 0},
    {"matrices", 'd', 4, 0}, {"origins", 'd', 3, 0}, {"directions", 'd', 3, 0},
    {"views", 'q', 0, 0},
};

static int is_consistent(const Py_buffer *views, const Work *work)
{
    return work->spare >= 0 && are_ends(&views[RINGS], views[POINTS].shape[0], 0)
           && are_ends(&views[OUTLINES], work->ring_count, 0)
           && views[MATRICES].shape[0] == 3 * work->view_count
           && views[ORIGINS].shape[0] == work->ray_count
           && views[DIRECTIONS].shape[0] == work->ray_count;
}

static PyObject *bound(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[ARRAYS];
    if (count != ARGUMENTS)
        return PyErr_Format(PyExc_TypeError, "Expected %d arguments, got %zd", ARGUMENTS, count);
    const long long spare = PyLong_AsLongLong(arguments[SPARE]);
    const double point_sine = PyFloat_AsDouble(arguments[SINE]);
    if (PyErr_Occurred() || !get_arrays(arguments, ARRAYS, KINDS, ARRAYS, views))
        return NULL;
    const Work work = {
        .points = views[POINTS].buf, .rings = views[RINGS].buf, .outlines = views[OUTLINES].buf,
        .matrices = views[MATRICES].buf, .origins = views[ORIGINS].buf,
        .directions = views[DIRECTIONS].buf, .views = views[VIEWS].buf,
        .view_count = views[OUTLINES].shape[0] - 1, .ring_count = views[RINGS].shape[0] - 1,
        .ray_count = views[VIEWS].shape[0], .spare = spare, .point_sine = point_sine,
    };
    const int agree = is_consistent(views, &work);
    Room room = {0};
    int fits = 1;
    Py_BEGIN_ALLOW_THREADS
    fits = !agree || bound_all(&work, &room);
    Py_END_ALLOW_THREADS
    PyObject *result = NULL;
    if (!agree)
        PyErr_SetString(PyExc_ValueError, "Expected outlines and lines of sight that agree");
    else if (!fits)
        PyErr_NoMemory();
    else
        result = Py_BuildValue("NN", bytes_of(&room.rays), bytes_of(&room.ends));
    free(room.events);
    free(room.rays.items);
    free(room.ends.items);
    release_arrays(views, ARRAYS);
    return result;
}

static PyMethodDef METHODS[] = {
    METHOD(bound,
           "Return the parts of lines of sight that are in just enough of the other volumes."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_strips)
