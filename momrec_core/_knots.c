/* What knots of contours bound: walls where contours lie upon each other, and outlines of regions.
 *
 * The contours of a knot are cut into chains; a chain that coincides with one of the other layer is
 * matched with it, and any other one lies inside or outside the other layer's pieces. That tells
 * which chains bound what faces up and what faces down, and they are followed around these regions.
 * The docstring of knots.py tells why.
 */

#include "_module.h"
#include "_plane.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

/* The arrays of a call, checked; see `Knots` in knots.py. */
typedef struct {
    const double *points;
    const int64_t *vertices;
    const uint8_t *is_own;
    const int64_t *first, *pieces, *knots;
    const uint8_t *is_above;
    const int64_t *links;
    Py_ssize_t point_count, vertex_count, contour_count, piece_count, link_count;
} Work;

/* What is known of a vertex. */
typedef struct {
    int64_t below;    /* the vertex below that it lies upon, or -1 */
    int64_t chain;    /* the last chain below that begins at it, or -1 */
    int64_t links[2]; /* vertices above that lie upon it; vertices below that it lies upon */
} Vertex;

/* Edges of a contour between two of its own vertices, one after the other. A place has the number
 * of the first chain that begins at it. */
typedef struct {
    int64_t begin, end; /* these edges, as a range of the vertices that they start from */
    int64_t contour;
    int64_t places[2]; /* where it begins and ends */
    int64_t partner;   /* the chain of the other layer that it lies upon, or -1 */
    int64_t claims;    /* chains whose partner it is */
    int64_t also;      /* another border that leaves its place and faces its way, or -1 */
    int64_t next;      /* the border that follows it */
    uint8_t is_above;
    uint8_t is_wall; /* the partner runs the same way: a wall stands between them */
    uint8_t is_back; /* as a border it is passed from its end to its beginning */
    uint8_t is_up;   /* as a border it bounds what faces up */
    uint8_t is_followed;
} Chain;

/* Chains in progress and results, with room for the most that there can be. */
typedef struct {
    Vertex *of_vertex;
    Chain *chains;
    int64_t *leaving; /* (2 * chains,): a border that leaves a place, facing down or up, or -1 */
    int64_t *surplus; /* (2 * chains,): borders that leave it less those that arrive */
    int64_t *triangles, *outlines, *loops, *regions, *failed;
    uint8_t *faces_up;
    int64_t chain_count, triangle_count, outline_count, loop_count, region_count, failed_count;
} Room;

/* The chains and contours of one knot: those below, then those above. */
typedef struct {
    int64_t number;
    int64_t contours[3]; /* where those below begin, where those above do, and where they end */
    int64_t chains[3];   /* likewise */
} Knot;

static int64_t knot_of(const Work *work, int64_t contour)
{
    return work->knots[work->pieces[contour]];
}

static int is_above(const Work *work, int64_t contour)
{
    return work->is_above[work->pieces[contour]] != 0;
}

/* --- chains --------------------------------------------------------------------------------- */

/* Return the vertex that an edge of a contour leads to. */
static int64_t head_of(const Work *work, int64_t contour, int64_t edge)
{
    return work->vertices[edge + 1 < work->first[contour + 1] ? edge + 1 : work->first[contour]];
}

/* Find a chain's first (0) or last (1) edge in the direction that it is passed in. */
static void find_edge(const Work *work, const Chain *chain, int is_last, int64_t ends[2])
{
    const int64_t edge = is_last != chain->is_back ? chain->end - 1 : chain->begin;
    ends[chain->is_back] = work->vertices[edge];
    ends[!chain->is_back] = head_of(work, chain->contour, edge);
}

static int64_t start_of(const Work *work, const Chain *chain)
{
    return work->vertices[chain->begin];
}

/* Return the place at which a chain of a knot begins. */
static int64_t enter_place(const Work *work, Room *room, const Knot *knot, int64_t number)
{
    Vertex *vertex = room->of_vertex + start_of(work, room->chains + number);
    if (!room->chains[number].is_above) {
        vertex->chain = number;
        return number;
    }
    const int64_t low = vertex->below < 0 ? -1 : room->of_vertex[vertex->below].chain;
    return low >= knot->chains[0] ? low : number;
}

/* Cut a contour into chains. */
static void cut_contour(const Work *work, Room *room, const Knot *knot, int64_t contour,
                        uint8_t is_above)
{
    const int64_t base = room->chain_count;
    for (int64_t place = work->first[contour]; place < work->first[contour + 1]; place++) {
        Chain *chain = room->chains + room->chain_count;
        if (work->is_own[place]) {
            *chain = (Chain){.begin = place, .contour = contour, .partner = -1, .also = -1,
                             .next = -1, .is_above = is_above};
            chain->places[0] = enter_place(work, room, knot, room->chain_count++);
        } else {
            chain--;
        }
        chain->end = place + 1;
    }
    for (int64_t number = base; number < room->chain_count; number++)
        room->chains[number].places[1] =
            room->chains[number + 1 < room->chain_count ? number + 1 : base].places[0];
}

/* Match chains above with those below that lie upon them, first what runs the other way; tell
 * whether none is matched with two. */
static int match_chains(Room *room, const Knot *knot)
{
    Chain *chains = room->chains;
    for (int is_wall = 0; is_wall < 2; is_wall++)
        for (int64_t high = knot->chains[1]; high < knot->chains[2]; high++) {
            const int64_t low = chains[high].places[!is_wall];
            if (chains[low].is_above || chains[low].places[1] != chains[high].places[is_wall])
                continue;
            chains[high].partner = low;
            chains[low].partner = high;
            chains[high].is_wall = chains[low].is_wall = (uint8_t)is_wall;
        }
    int is_clear = 1;
    for (int64_t number = knot->chains[0]; number < knot->chains[2]; number++)
        if (chains[number].partner >= 0)
            is_clear &= ++chains[chains[number].partner].claims < 2;
    return is_clear;
}

/* --- inside or outside ---------------------------------------------------------------------- */

/* Tell whether a chain's middle lies inside the knot's pieces of the other layer. */
static int is_inside(const Work *work, const Knot *knot, const Chain *chain)
{
    const double *start = work->points + 3 * start_of(work, chain);
    const double *end = work->points + 3 * head_of(work, chain->contour, chain->end - 1);
    const double middle[2] = {(start[0] + end[0]) / 2, (start[1] + end[1]) / 2};
    int inside = 0;
    const int64_t *contours = knot->contours + !chain->is_above;
    for (int64_t contour = contours[0]; contour < contours[1]; contour++) {
        const int64_t last = work->first[contour + 1] - 1;
        const double *before = work->points + 3 * work->vertices[last];
        for (int64_t place = work->first[contour]; place <= last; place++) {
            const double *point = work->points + 3 * work->vertices[place];
            inside ^= is_passed(before, point, middle);
            before = point;
        }
    }
    return inside;
}

/* The square of the distance between a chain's ends. */
static double square_of(const Work *work, const Chain *chain)
{
    const double *start = work->points + 3 * start_of(work, chain);
    const double *end = work->points + 3 * head_of(work, chain->contour, chain->end - 1);
    const double x = end[0] - start[0], y = end[1] - start[1];
    return x * x + y * y;
}

static int is_alone(const Chain *chain) { return !chain->is_wall && chain->partner < 0; }

/* Find the chains that run on from one without meeting the other layer; return where they end. */
static int64_t find_run(const Work *work, const Room *room, const Knot *knot, int64_t number,
                        const Chain **longest)
{
    const Chain *chains = room->chains;
    const int64_t contour = chains[number].contour;
    double greatest = -1.0;
    *longest = chains + number;
    do {
        const double square = square_of(work, chains + number);
        if (!(square < greatest)) {
            greatest = square;
            *longest = chains + number;
        }
        number++;
    } while (number < knot->chains[2] && is_alone(chains + number)
             && chains[number].contour == contour
             && !room->of_vertex[start_of(work, chains + number)].links[chains[number].is_above]);
    return number;
}

/* Decide which way the chains that are no walls are passed, and what they bound. */
static void turn_borders(const Work *work, Room *room, const Knot *knot)
{
    Chain *chains = room->chains;
    for (int64_t number = knot->chains[0]; number < knot->chains[2];) {
        const int64_t begin = number++;
        uint8_t inside = 0;
        if (is_alone(chains + begin)) {
            const Chain *longest;
            number = find_run(work, room, knot, begin, &longest);
            inside = (uint8_t)is_inside(work, knot, longest);
        }
        for (int64_t turned = begin; turned < number; turned++) {
            chains[turned].is_back = inside;
            chains[turned].is_up = chains[turned].is_above == inside;
        }
    }
}

/* --- outlines ------------------------------------------------------------------------------- */

/* Return where a border leaves (0) or arrives (1), among the places of what faces its way. */
static int64_t stop_of(const Chain *border, int arrives)
{
    return 2 * border->places[arrives != border->is_back] + border->is_up;
}

/* Enter the borders where they leave; tell whether as many arrive. */
static int enter_borders(Room *room, const Knot *knot)
{
    for (int64_t stop = 2 * knot->chains[0]; stop < 2 * knot->chains[2]; stop++) {
        room->leaving[stop] = -1;
        room->surplus[stop] = 0;
    }
    for (int64_t number = knot->chains[2] - 1; number >= knot->chains[0]; number--) {
        Chain *chain = room->chains + number;
        if (chain->is_wall)
            continue;
        const int64_t stop = stop_of(chain, 0);
        chain->also = room->leaving[stop];
        room->leaving[stop] = number;
        room->surplus[stop]++;
        room->surplus[stop_of(chain, 1)]--;
    }
    int closes = 1;
    for (int64_t stop = 2 * knot->chains[0]; stop < 2 * knot->chains[2]; stop++)
        closes &= room->surplus[stop] == 0;
    return closes;
}

/* Return how far one edge turns to the left of another. */
static double turn_between(const Work *work, const int64_t edge[2], const int64_t lead[2])
{
    const double *points = work->points;
    double heading[2], onward[2];
    for (int axis = 0; axis < 2; axis++) {
        heading[axis] = points[3 * edge[1] + axis] - points[3 * edge[0] + axis];
        onward[axis] = points[3 * lead[1] + axis] - points[3 * lead[0] + axis];
    }
    return atan2(heading[0] * onward[1] - heading[1] * onward[0],
                 heading[0] * onward[0] + heading[1] * onward[1]);
}

/* Take the border that turns furthest to the left where a border arrives. */
static int64_t take_next(const Work *work, Room *room, const Chain *border)
{
    Chain *chains = room->chains;
    int64_t *best = &room->leaving[stop_of(border, 1)];
    if (chains[*best].also >= 0) {
        double most = -INFINITY;
        int64_t edge[2], lead[2];
        find_edge(work, border, 1, edge);
        for (int64_t *at = best; *at >= 0; at = &chains[*at].also) {
            find_edge(work, chains + *at, 0, lead);
            const double turn = turn_between(work, edge, lead);
            if (turn > most) {
                most = turn;
                best = at;
            }
        }
    }
    const int64_t next = *best;
    *best = chains[next].also;
    return next;
}

static void add_triangle(Room *room, int64_t a, int64_t b, int64_t c)
{
    int64_t *triangle = room->triangles + 3 * room->triangle_count++;
    triangle[0] = a;
    triangle[1] = b;
    triangle[2] = c;
}

/* Find the border after each; where it is of the other layer, a vertical triangle leads over. */
static void link_borders(const Work *work, Room *room, const Knot *knot)
{
    for (int64_t number = knot->chains[0]; number < knot->chains[2]; number++) {
        Chain *border = room->chains + number;
        if (border->is_wall)
            continue;
        border->next = take_next(work, room, border);
        int64_t edge[2], lead[2];
        find_edge(work, border, 1, edge);
        find_edge(work, room->chains + border->next, 0, lead);
        if (edge[1] == lead[0])
            continue;
        if (border->is_up)
            add_triangle(room, edge[0], edge[1], lead[0]);
        else
            add_triangle(room, lead[0], edge[1], edge[0]);
    }
}

/* Write the vertices that the edges along a border start from. */
static void write_border(const Work *work, Room *room, const Chain *border)
{
    for (int64_t step = 0; step < border->end - border->begin; step++)
        room->outlines[room->outline_count++] =
            border->is_back ? head_of(work, border->contour, border->end - 1 - step)
                            : work->vertices[border->begin + step];
}

/* Write the outlines of what faces down or up in a knot. */
static void write_region(const Work *work, Room *room, const Knot *knot, uint8_t is_up)
{
    Chain *chains = room->chains;
    const int64_t loops = room->loop_count;
    for (int64_t number = knot->chains[0]; number < knot->chains[2]; number++) {
        if (chains[number].is_wall || chains[number].is_up != is_up || chains[number].is_followed)
            continue;
        for (int64_t at = number; !chains[at].is_followed; at = chains[at].next) {
            chains[at].is_followed = 1;
            write_border(work, room, chains + at);
        }
        room->loops[++room->loop_count] = room->outline_count;
    }
    if (room->loop_count > loops) {
        room->faces_up[room->region_count++] = is_up;
        room->regions[room->region_count] = room->loop_count;
    }
}

/* Write the vertical triangles along one of two chains that lie upon each other. */
static void write_wall(const Work *work, Room *room, const Chain *chain)
{
    const Chain *partner = room->chains + chain->partner;
    const int64_t foot = head_of(work, partner->contour, partner->end - 1);
    const int64_t apex = start_of(work, partner);
    for (int64_t edge = chain->begin; edge < chain->end; edge++) {
        const int64_t tail = work->vertices[edge], head = head_of(work, chain->contour, edge);
        if (chain->is_above)
            add_triangle(room, foot, head, tail);
        else
            add_triangle(room, tail, head, apex);
    }
}

/* --- knots ---------------------------------------------------------------------------------- */

/* Cut the contours of a knot into chains; tell whether none of its vertices touches two others. */
static int cut_knot(const Work *work, Room *room, Knot *knot)
{
    for (int side = 0; side < 2; side++) {
        knot->chains[side] = room->chain_count;
        for (int64_t at = knot->contours[side]; at < knot->contours[side + 1]; at++)
            cut_contour(work, room, knot, at, (uint8_t)side);
    }
    knot->chains[2] = room->chain_count;
    int is_clear = 1;
    for (int64_t number = knot->chains[0]; number < knot->chains[2]; number++) {
        const Chain *chain = room->chains + number;
        is_clear &= room->of_vertex[start_of(work, chain)].links[chain->is_above] < 2;
    }
    return is_clear;
}

static void outline_knot(const Work *work, Room *room, Knot *knot)
{
    int is_clear = cut_knot(work, room, knot);
    is_clear &= match_chains(room, knot);
    turn_borders(work, room, knot);
    if (!enter_borders(room, knot) || !is_clear) {
        room->failed[room->failed_count++] = knot->number;
        return;
    }
    for (int64_t number = knot->chains[0]; number < knot->chains[2]; number++)
        if (room->chains[number].is_wall)
            write_wall(work, room, room->chains + number);
    link_borders(work, room, knot);
    write_region(work, room, knot, 0);
    write_region(work, room, knot, 1);
}

static void enter_links(const Work *work, Room *room)
{
    const Vertex unknown = {-1, -1, {0, 0}};
    for (Py_ssize_t place = 0; place < work->vertex_count; place++)
        room->of_vertex[work->vertices[place]] = unknown;
    for (Py_ssize_t end = 0; end < 2 * work->link_count; end++)
        room->of_vertex[work->links[end]] = unknown;
    for (Py_ssize_t link = 0; link < work->link_count; link++) {
        const int64_t low = work->links[2 * link], high = work->links[2 * link + 1];
        room->of_vertex[high].below = low;
        room->of_vertex[low].links[0]++;
        room->of_vertex[high].links[1]++;
    }
}

static void outline_all(const Work *work, Room *room)
{
    enter_links(work, room);
    room->loops[0] = room->regions[0] = 0;
    for (int64_t contour = 0; contour < work->contour_count;) {
        Knot knot = {.number = knot_of(work, contour), .contours = {contour}};
        for (int side = 0; side < 2; side++) {
            while (contour < work->contour_count && is_above(work, contour) == side
                   && knot_of(work, contour) == knot.number)
                contour++;
            knot.contours[side + 1] = contour;
        }
        outline_knot(work, room, &knot);
    }
}

/* --- arrays from Python --------------------------------------------------------------------- */

enum { POINTS, VERTICES, IS_OWN, FIRST, PIECES, KNOTS, IS_ABOVE, LINKS, ARRAYS };

/* Tell whether the first vertex of each contour is its own. */
static int are_cut(const Work *work)
{
    for (Py_ssize_t contour = 0; contour < work->contour_count; contour++)
        if (!work->is_own[work->first[contour]])
            return 0;
    return 1;
}

/* Tell whether the contours are in the order of their knots, those below before those above. */
static int are_in_order(const Work *work)
{
    for (Py_ssize_t contour = 1; contour < work->contour_count; contour++) {
        const int64_t one = knot_of(work, contour - 1), other = knot_of(work, contour);
        if (one > other
            || (one == other && is_above(work, contour - 1) > is_above(work, contour)))
            return 0;
    }
    return 1;
}

static int is_consistent(const Py_buffer *views, Work *work)
{
    *work = (Work){
        .points = views[POINTS].buf, .vertices = views[VERTICES].buf, .is_own = views[IS_OWN].buf,
        .first = views[FIRST].buf, .pieces = views[PIECES].buf, .knots = views[KNOTS].buf,
        .is_above = views[IS_ABOVE].buf, .links = views[LINKS].buf,
        .point_count = views[POINTS].shape[0], .vertex_count = views[VERTICES].shape[0],
        .contour_count = views[FIRST].shape[0] - 1, .piece_count = views[KNOTS].shape[0],
        .link_count = views[LINKS].shape[0],
    };
    return views[IS_OWN].shape[0] == work->vertex_count
           && views[PIECES].shape[0] == work->contour_count
           && views[IS_ABOVE].shape[0] == work->piece_count
           && are_within(work->vertices, work->vertex_count, work->point_count)
           && are_within(work->pieces, work->contour_count, work->piece_count)
           && are_within(work->links, 2 * work->link_count, work->point_count)
           && are_ends(&views[FIRST], work->vertex_count, 1) && are_cut(work)
           && are_in_order(work);
}

/* Get memory for as much as there can be; return whether there is enough. */
static int get_room(const Work *work, Room *room)
{
    const size_t most = (size_t)work->vertex_count + 1;
    *room = (Room){
        .of_vertex = malloc(((size_t)work->point_count + 1) * sizeof(Vertex)),
        .chains = malloc(most * sizeof(Chain)),
        .leaving = malloc(2 * most * sizeof(int64_t)),
        .surplus = malloc(2 * most * sizeof(int64_t)),
        .triangles = malloc(3 * most * sizeof(int64_t)),
        .outlines = malloc(most * sizeof(int64_t)),
        .loops = malloc(most * sizeof(int64_t)),
        .regions = malloc(most * sizeof(int64_t)),
        .failed = malloc(most * sizeof(int64_t)),
        .faces_up = malloc(most),
    };
    return room->of_vertex && room->chains && room->leaving && room->surplus && room->triangles
           && room->outlines && room->loops && room->regions && room->failed && room->faces_up;
}

static void free_room(Room *room)
{
    free(room->of_vertex);
    free(room->chains);
    free(room->leaving);
    free(room->surplus);
    free(room->triangles);
    free(room->outlines);
    free(room->loops);
    free(room->regions);
    free(room->failed);
    free(room->faces_up);
}

static PyObject *as_bytes(const int64_t *numbers, int64_t count)
{
    return PyBytes_FromStringAndSize((const char *)numbers,
                                     (Py_ssize_t)(count * (int64_t)sizeof(int64_t)));
}

static PyObject *result_of(const Room *room)
{
    return Py_BuildValue(
        "NNNNNN", as_bytes(room->triangles, 3 * room->triangle_count),
        as_bytes(room->outlines, room->outline_count), as_bytes(room->loops, room->loop_count + 1),
        as_bytes(room->regions, room->region_count + 1),
        as_bytes(room->failed, room->failed_count),
        PyBytes_FromStringAndSize((const char *)room->faces_up, (Py_ssize_t)room->region_count));
}

static PyObject *outline(PyObject *module, PyObject *const *arguments, Py_ssize_t count)
{
    (void)module;
    const ArrayKind expected[ARRAYS] = {
        {"points", 'd', 3, 0}, {"vertices", 'q', 0, 0}, {"is_own", '?', 0, 0},
        {"first", 'q', 0, 0},  {"pieces", 'q', 0, 0},   {"knots", 'q', 0, 0},
        {"is_above", '?', 0, 0}, {"links", 'q', 2, 0},
    };
    Py_buffer views[ARRAYS];
    if (!get_arrays(arguments, count, expected, ARRAYS, views))
        return NULL;
    Work work;
    PyObject *result = NULL;
    if (is_consistent(views, &work)) {
        Room room;
        int fits;
        Py_BEGIN_ALLOW_THREADS
        fits = get_room(&work, &room);
        if (fits)
            outline_all(&work, &room);
        Py_END_ALLOW_THREADS
        result = fits ? result_of(&room) : PyErr_NoMemory();
        free_room(&room);
    } else {
        PyErr_SetString(PyExc_ValueError, "Expected contours with vertices, in the order of their "
                                          "knots and layers, and arrays that agree");
    }
    release_arrays(views, ARRAYS);
    return result;
}

static PyMethodDef METHODS[] = {
    METHOD(outline, "Find the walls of knots, and the outlines of what faces down and up in them."),
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_knots)
