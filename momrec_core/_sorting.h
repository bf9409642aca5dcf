/* Items brought into order, most of the time only a few. */

#ifndef MOMREC_SORTING_H
#define MOMREC_SORTING_H

#include <stdlib.h>
#include <string.h>

/* So many items, of so many bytes at the most, are sorted by inserting one after the other. */
enum { FEW_ITEMS = 32, ITEM_BYTES = 64 };

/* Sort as qsort does, and faster where items are few and the comparison is known here. */
static inline void sort_items(void *items, size_t count, size_t size,
                              int (*compare)(const void *, const void *))
{
    char *const begin = items;
    double room[ITEM_BYTES / sizeof(double)]; /* aligned as the items are */
    char *const item = (char *)room;
    if (count > FEW_ITEMS || size > ITEM_BYTES) {
        qsort(items, count, size, compare);
        return;
    }
    for (size_t next = 1; next < count; next++) {
        char *place = begin + next * size;
        memcpy(item, place, size);
        for (; place > begin && compare(item, place - size) < 0; place -= size)
            memcpy(place, place - size, size);
        memcpy(place, item, size);
    }
}

#endif
