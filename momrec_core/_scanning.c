/* Outlines cut into segments by many parallel scan lines, one line after the other. */

#include "_lists.h"
#include "_module.h"
#include "_sorting.h"

#include <stdint.h>
#include <stdlib.h>

typedef struct {
    const double *points;  /* (vertices, 2): coordinates along and across the lines */
    const int64_t *rings;  /* (ring_count + 1,): where each begins, and where the last ends */
    const double *offsets; /* (line_count,): where the lines are, across */
    Py_ssize_t ring_count, line_count;
    double clearance; /* segments that are no further apart are one, and none is narrower */
} Work;

typedef struct {
    List places;        /* of one line, where it crosses the outline */
    List spans, counts; /* results */
} Room;

/* Note where a line crosses a ring. */
static int cross_ring(const Work *work, Room *room, int64_t ring, double offset)
{
    const double *end = work->points + 2 * work->rings[ring + 1];
    const double *there = work->points + 2 * work->rings[ring], *here = end - 2;
    for (; there < end; here = there, there += 2) {
        if ((here[1] <= offset) == (there[1] <= offset))
            continue;
        double *place = appended(&room->places, sizeof(double));
        if (place == NULL)
            return 0;
        *place = here[0] + (offset - here[1]) / (there[1] - here[1]) * (there[0] - here[0]);
    }
    return 1;
}

static int in_order(const void *one, const void *other)
{
    const double first = *(const double *)one, second = *(const double *)other;
    return (first > second) - (first < second);
}

static int add_span(Room *room, double low, double high)
{
    double *span = appended(&room->spans, 2 * sizeof(double));
    if (span == NULL)
        return 0;
    span[0] = low;
    span[1] = high;
    return 1;
}

/* Add the segments of one line that are inside the outline. */
static int scan_line(const Work *work, Room *room, double offset)
{
    room->places.count = 0;
    for (int64_t ring = 0; ring < work->ring_count; ring++)
        if (!cross_ring(work, room, ring, offset))
            return 0;
    const double *places = room->places.items;
    const size_t count = room->places.count, before = room->spans.count;
    sort_items(room->places.items, count, sizeof(double), in_order);
    size_t begin = 0; /* of the segments that are one */
    for (size_t end = 1; end < count; end += 2) {
        if (end + 1 < count && !(places[end + 1] - places[end] > work->clearance))
            continue;
        if (places[end] - places[begin] > work->clearance
            && !add_span(room, places[begin], places[end]))
            return 0;
        begin = end + 1;
    }
    int64_t *spans = appended(&room->counts, sizeof(int64_t));
    if (spans != NULL)
        *spans = (int64_t)(room->spans.count - before);
    return spans != NULL;
}

static PyObject *scan(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    static const ArrayKind KINDS[] = {
        {"points", 'd', 2, 0}, {"rings", 'q', 0, 0}, {"offsets", 'd', 0, 0},
    };
    Py_buffer views[3];
    if (count != 4)
        return PyErr_Format(PyExc_TypeError, "Expected 4 arguments, got %zd", count);
    const double clearance = PyFloat_AsDouble(arguments[3]);
    if (PyErr_Occurred() || !get_arrays(arguments, 3, KINDS, 3, views))
        return NULL;
    const Work work = {
        .points = views[0].buf, .rings = views[1].buf, .offsets = views[2].buf,
        .ring_count = views[1].shape[0] - 1, .line_count = views[2].shape[0],
        .clearance = clearance,
    };
    const int agree = are_ends(&views[1], views[0].shape[0], 1);
    Room room = {0};
    int fits = 1;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t line = 0; agree && fits && line < work.line_count; line++)
        fits = scan_line(&work, &room, work.offsets[line]);
    Py_END_ALLOW_THREADS
    PyObject *result = NULL;
    if (!agree)
        PyErr_SetString(PyExc_ValueError, "Expected rings with vertices");
    else if (!fits)
        PyErr_NoMemory();
    else
        result = Py_BuildValue("NN", bytes_of(&room.spans), bytes_of(&room.counts));
    free(room.places.items);
    free(room.spans.items);
    free(room.counts.items);
    release_arrays(views, 3);
    return result;
}

static PyMethodDef METHODS[] = {
    METHOD(scan, "Return the segments of scan lines that lie inside an outline."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_scanning)
