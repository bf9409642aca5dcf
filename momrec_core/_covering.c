/* Where the projection of a closed mesh begins and ends on scan lines: a loop over all edges for
 * each image, of which array operations would make many passes.
 */

#include "_lists.h"
#include "_module.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

static const double LEAST_DEPTH = 1e-9; /* of the largest: nearer, or behind, counts as far off */
enum { TOGETHER = 8 }; /* images that the edges are gone through for at once, a bit of a byte each */
enum { FEW = 24 }; /* half edges that are sorted by insertion */

typedef struct {
    const double *vertices; /* (vertex_count, 3) */
    const int64_t *faces;   /* (face_count, 3) */
    int64_t vertex_count, face_count;
} Mesh;

/* A side of a face, at the lower of its two vertices. */
typedef struct {
    int64_t higher, side;
} HalfEdge;

/* An edge as the first of its two faces runs through it. */
typedef struct {
    int64_t tail, head, first, second;
} Edge;

/* Images that a mesh is seen in together; rows count the scan lines. */
typedef struct {
    const double *projections, *eyes; /* (count, 3, 4) and (count, 4): points or directions */
    int64_t first, count;             /* the number of the first among all images, and how many */
    int64_t lines;
    double least_depths[TOGETHER];
} Images;

/* Where a vertex is in an image. */
typedef struct {
    double place, row;
    int64_t level; /* the first line at or above, 0 to the number of lines */
} Seen;

typedef struct {
    double image, line, place, way;
} Crossing;

typedef enum { DONE, OPEN, NO_MEMORY } Outcome;

static int compare(const void *one, const void *other)
{
    const int64_t left = ((const HalfEdge *)one)->higher, right = ((const HalfEdge *)other)->higher;
    return (left > right) - (left < right);
}

static void sort(HalfEdge *halves, size_t count)
{
    if (count > FEW) {
        qsort(halves, count, sizeof(HalfEdge), compare);
        return;
    }
    for (size_t place = 1; place < count; place++) {
        const HalfEdge moved = halves[place];
        size_t free_place = place;
        for (; free_place > 0 && halves[free_place - 1].higher > moved.higher; free_place--)
            halves[free_place] = halves[free_place - 1];
        halves[free_place] = moved;
    }
}

static int64_t end_of(const Mesh *mesh, int64_t side)
{
    return mesh->faces[side % 3 == 2 ? side - 2 : side + 1];
}

/* Gather the sides of all faces at the lower of their vertices; `first` tells where each begins. */
static void gather(const Mesh *mesh, int64_t *first, HalfEdge *halves)
{
    const int64_t sides = 3 * mesh->face_count;
    for (int64_t side = 0; side < sides; side++) {
        const int64_t tail = mesh->faces[side], head = end_of(mesh, side);
        first[(tail < head ? tail : head) + 2]++;
    }
    for (int64_t vertex = 0; vertex < mesh->vertex_count; vertex++)
        first[vertex + 2] += first[vertex + 1];
    for (int64_t side = 0; side < sides; side++) {
        const int64_t tail = mesh->faces[side], head = end_of(mesh, side);
        const HalfEdge half = {tail < head ? head : tail, side};
        halves[first[(tail < head ? tail : head) + 1]++] = half;
    }
}

/* Pair the sides of faces to edges (3 face_count / 2); each edge must have two faces. */
static Outcome pair_sides(const Mesh *mesh, Edge *edges)
{
    int64_t *first = calloc((size_t)mesh->vertex_count + 2, sizeof(int64_t));
    HalfEdge *halves = malloc(3 * (size_t)mesh->face_count * sizeof(HalfEdge));
    Outcome outcome = first != NULL && halves != NULL ? DONE : NO_MEMORY;
    if (outcome == DONE)
        gather(mesh, first, halves);
    for (int64_t vertex = 0; outcome == DONE && vertex < mesh->vertex_count; vertex++) {
        const int64_t count = first[vertex + 1] - first[vertex];
        HalfEdge *half = halves + first[vertex];
        sort(half, (size_t)count);
        if (count % 2)
            outcome = OPEN;
        for (int64_t pair = 0; outcome == DONE && pair < count / 2; pair++, half += 2) {
            const int64_t side = half[0].side, other = half[1].side;
            const Edge edge = {mesh->faces[side], end_of(mesh, side), side / 3, other / 3};
            *edges++ = edge;
            if (half[0].higher != half[1].higher)
                outcome = OPEN;
        }
    }
    free(first);
    free(halves);
    return outcome;
}

/* Write the plane (4,) of each face, whose product with points is positive on the outer side. */
static void find_planes(const Mesh *mesh, double *planes)
{
    for (int64_t face = 0; face < mesh->face_count; face++, planes += 4) {
        const double *corners[3];
        double sides[2][3];
        for (int corner = 0; corner < 3; corner++)
            corners[corner] = mesh->vertices + 3 * mesh->faces[3 * face + corner];
        for (int axis = 0; axis < 3; axis++) {
            sides[0][axis] = corners[1][axis] - corners[0][axis];
            sides[1][axis] = corners[2][axis] - corners[0][axis];
        }
        planes[0] = sides[0][1] * sides[1][2] - sides[0][2] * sides[1][1];
        planes[1] = sides[0][2] * sides[1][0] - sides[0][0] * sides[1][2];
        planes[2] = sides[0][0] * sides[1][1] - sides[0][1] * sides[1][0];
        planes[3] = -(planes[0] * corners[0][0] + planes[1] * corners[0][1]
                      + planes[2] * corners[0][2]);
    }
}

static double product(const double *row, const double *point)
{
    return row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3];
}

/* Find how near to each camera a vertex may come. */
static void find_least_depths(const Mesh *mesh, Images *images)
{
    for (int64_t image = 0; image < images->count; image++) {
        const double *row = images->projections + 12 * image + 8;
        double farthest = 0.0;
        for (int64_t vertex = 0; vertex < mesh->vertex_count; vertex++) {
            const double depth = fabs(product(row, mesh->vertices + 3 * vertex));
            farthest = depth > farthest ? depth : farthest;
        }
        images->least_depths[image] = LEAST_DEPTH * farthest;
    }
}

/* Tell of each face in which of the images it turns towards the camera, a bit for each. */
static void find_fronts(const Mesh *mesh, const double *planes, const Images *images,
                        uint8_t *fronts)
{
    for (int64_t face = 0; face < mesh->face_count; face++) {
        const double *plane = planes + 4 * face, *eye = images->eyes;
        unsigned bits = 0;
        for (int64_t image = 0; image < images->count; image++, eye += 4) {
            const double side = plane[0] * eye[0] + plane[1] * eye[1] + plane[2] * eye[2]
                                + plane[3] * eye[3];
            bits |= (unsigned)(side > 0.0) << image;
        }
        fronts[face] = (uint8_t)bits;
    }
}

static Seen see(const Mesh *mesh, const Images *images, int64_t image, int64_t vertex)
{
    const double *projection = images->projections + 12 * image;
    const double *point = mesh->vertices + 3 * vertex, lines = (double)images->lines;
    const double depth = fmax(product(projection + 8, point), images->least_depths[image]);
    const double row = product(projection + 4, point) / depth;
    const int64_t level = row > lines ? images->lines : row > 0.0 ? (int64_t)ceil(row) : 0;
    return (Seen){product(projection, point) / depth, row, level};
}

/* Cross an edge between a front and a back with the scan lines of an image, as its front runs. */
static Outcome cross(const Mesh *mesh, const Images *images, int64_t image, const Edge *edge,
                     int is_front, List *crossings)
{
    const Seen from = see(mesh, images, image, edge->tail);
    const Seen to = see(mesh, images, image, edge->head);
    const int rises = to.level > from.level;
    const double slope = (to.place - from.place) / (to.row - from.row);
    for (int64_t line = rises ? from.level : to.level; line < (rises ? to.level : from.level);
         line++) {
        Crossing *crossing = appended(crossings, sizeof(Crossing));
        if (crossing == NULL)
            return NO_MEMORY;
        *crossing = (Crossing){(double)(images->first + image), (double)line,
                               from.place + ((double)line - from.row) * slope,
                               rises == is_front ? 1.0 : -1.0};
    }
    return DONE;
}

/* Cross all edges that are between a front and a back in any of the images. */
static Outcome cross_rims(const Mesh *mesh, const Images *images, const Edge *edges,
                          const uint8_t *fronts, List *crossings)
{
    for (const Edge *edge = edges; edge < edges + 3 * mesh->face_count / 2; edge++) {
        const unsigned here = fronts[edge->first], rims = here ^ fronts[edge->second];
        for (int64_t image = 0; rims >> image; image++)
            if (rims >> image & 1
                && cross(mesh, images, image, edge, here >> image & 1, crossings) != DONE)
                return NO_MEMORY;
    }
    return DONE;
}

static Outcome cross_all(const Mesh *mesh, const double *projections, const double *eyes,
                         int64_t count, int64_t lines, List *crossings)
{
    const size_t faces = (size_t)mesh->face_count;
    uint8_t *fronts = malloc(faces);
    double *planes = malloc(4 * faces * sizeof(double));
    Edge *edges = malloc(2 * faces * sizeof(Edge));
    Outcome outcome = NO_MEMORY;
    if (fronts && planes && edges)
        outcome = mesh->face_count % 2 ? OPEN : pair_sides(mesh, edges);
    if (outcome == DONE)
        find_planes(mesh, planes);
    for (int64_t first = 0; outcome == DONE && first < count; first += TOGETHER) {
        Images images = {projections + 12 * first, eyes + 4 * first, first,
                         count - first < TOGETHER ? count - first : TOGETHER, lines, {0.0}};
        find_least_depths(mesh, &images);
        find_fronts(mesh, planes, &images, fronts);
        outcome = cross_rims(mesh, &images, edges, fronts, crossings);
    }
    free(fronts);
    free(planes);
    free(edges);
    return outcome;
}

/* --- arrays from Python ------------------------------------------------------------------- */

enum { VERTICES, FACES, PROJECTIONS, EYES, ARRAYS };
static const ArrayKind KINDS[ARRAYS] = {
    {"vertices", 'd', 3, 0}, {"faces", 'q', 3, 0}, {"projections", 'd', 12, 0}, {"eyes", 'd', 4, 0},
};

static int is_mesh(const Mesh *mesh)
{
    return mesh->face_count > 0
           && are_within(mesh->faces, 3 * mesh->face_count, mesh->vertex_count);
}

static PyObject *rims(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    Py_buffer views[ARRAYS];
    const long lines = count == ARRAYS + 1 ? PyLong_AsLong(arguments[ARRAYS]) : 0;
    if (PyErr_Occurred() || !get_arrays(arguments, count - 1, KINDS, ARRAYS, views))
        return NULL;
    const Mesh mesh = {views[VERTICES].buf, views[FACES].buf, views[VERTICES].shape[0],
                       views[FACES].shape[0]};
    const int64_t images = views[PROJECTIONS].shape[0];
    List crossings = {0};
    Outcome outcome = OPEN;
    if (is_mesh(&mesh) && views[EYES].shape[0] == images) {
        Py_BEGIN_ALLOW_THREADS
        outcome = cross_all(&mesh, views[PROJECTIONS].buf, views[EYES].buf, images, lines,
                            &crossings);
        Py_END_ALLOW_THREADS
    }
    release_arrays(views, ARRAYS);
    PyObject *result = NULL;
    if (outcome == DONE)
        result = bytes_of(&crossings);
    else if (outcome == NO_MEMORY)
        PyErr_NoMemory();
    else
        PyErr_SetString(PyExc_ValueError, "Expected a closed mesh whose edges have two faces each");
    free(crossings.items);
    return result;
}

static PyMethodDef METHODS[] = {
    METHOD(rims, "Return where the edges that bound a mesh's projections cross scan lines."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_covering)
