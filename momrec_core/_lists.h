/* Memory that grows, and what is in it as bytes for Python. */

#ifndef MOMREC_LISTS_H
#define MOMREC_LISTS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdlib.h>

/* Items of one size. */
typedef struct {
    void *items;
    size_t count, room, size;
} List;

/* Make room for so many items; return NULL where the memory does not suffice. */
static inline void *reserved(List *list, size_t count, size_t size)
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

/* Make room for one item more, and count it; return its place, or NULL. */
static inline void *appended(List *list, size_t size)
{
    if (reserved(list, list->count + 1, size) == NULL)
        return NULL;
    return (char *)list->items + size * list->count++;
}

static inline PyObject *bytes_of(const List *list)
{
    return PyBytes_FromStringAndSize(list->items, (Py_ssize_t)(list->count * list->size));
}

#endif
