/* Points against edges, seen in the plane of their first two coordinates. */

#ifndef MOMREC_PLANE_H
#define MOMREC_PLANE_H

/* Return twice the area of a triangle: positive where the point is on the left of the edge. */
static inline double cross(const double *start, const double *end, const double *point)
{
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0]);
}

/* Tell whether a ray to the right from a point crosses an edge. */
static inline int is_passed(const double *start, const double *end, const double *point)
{
    if ((start[1] <= point[1]) == (end[1] <= point[1]))
        return 0;
    return (cross(start, end, point) > 0) == (end[1] > start[1]);
}

#endif
