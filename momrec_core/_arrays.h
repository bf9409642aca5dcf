/* Arrays handed over from Python by the buffer protocol, checked before C trusts them. */

#ifndef MOMREC_ARRAYS_H
#define MOMREC_ARRAYS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdint.h>

/* What an argument must be. */
typedef struct {
    const char *name;
    char kind;   /* d: float64, q: int64, ?: bool */
    int columns; /* 0: one-dimensional */
    int is_out;
} ArrayKind;

static inline int is_of_kind(const Py_buffer *view, const ArrayKind *kind)
{
    const char *format = view->format ? view->format : "B";
    const int fits = *format == kind->kind
                     || (kind->kind == 'q' && *format == 'l' && view->itemsize == 8);
    return fits && view->ndim == 1 + (kind->columns > 0)
           && (!kind->columns || view->shape[1] == kind->columns);
}

static inline void release_arrays(Py_buffer *views, int count)
{
    while (count > 0)
        PyBuffer_Release(&views[--count]);
}

/* Tell whether arrays share memory. */
static inline int do_overlap(const Py_buffer *one, const Py_buffer *other)
{
    const uintptr_t begin = (uintptr_t)one->buf, other_begin = (uintptr_t)other->buf;
    return one->len > 0 && other->len > 0 && begin < other_begin + (uintptr_t)other->len
           && other_begin < begin + (uintptr_t)one->len;
}

/* Tell whether no output shares memory with another array: what has been checked must stay. */
static inline int are_apart(const Py_buffer *views, const ArrayKind *kinds, int count)
{
    for (int out = 0; out < count; out++)
        for (int other = 0; other < count && kinds[out].is_out; other++)
            if (other != out && do_overlap(&views[out], &views[other])) {
                PyErr_Format(PyExc_ValueError, "Expected %s to share no memory with %s",
                             kinds[out].name, kinds[other].name);
                return 0;
            }
    return 1;
}

/* Get contiguous arrays of the expected kinds, outputs apart from all others; return 0 with an
 * error set if one is not. */
static inline int get_arrays(PyObject *const *arguments, Py_ssize_t given, const ArrayKind *kinds,
                             int count, Py_buffer *views)
{
    if (given != count) {
        PyErr_Format(PyExc_TypeError, "Expected %d arrays, got %zd", count, given);
        return 0;
    }
    for (int got = 0; got < count; got++) {
        const int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT;
        if (PyObject_GetBuffer(arguments[got], &views[got],
                               kinds[got].is_out ? flags | PyBUF_WRITABLE : flags)) {
            release_arrays(views, got);
            return 0;
        }
        if (!is_of_kind(&views[got], &kinds[got])) {
            PyErr_Format(PyExc_TypeError, "Expected another kind or shape of %s", kinds[got].name);
            release_arrays(views, got + 1);
            return 0;
        }
    }
    if (are_apart(views, kinds, count))
        return 1;
    release_arrays(views, count);
    return 0;
}

static inline void release_tables(Py_buffer *views, Py_ssize_t tables, int count)
{
    for (Py_ssize_t place = 0; place < tables * count; place++)
        PyBuffer_Release(&views[place]);
    PyMem_Free(views);
}

/* Get the arrays of each tuple in a tuple; return NULL with an error set if one is not right. */
static inline Py_buffer *get_tables(PyObject *tables, const ArrayKind *kinds, int count)
{
    if (!PyTuple_Check(tables))
        return (Py_buffer *)PyErr_Format(PyExc_TypeError, "Expected a tuple of tuples of arrays");
    const Py_ssize_t given = PyTuple_GET_SIZE(tables);
    Py_buffer *views = PyMem_Calloc((size_t)given * (size_t)count + 1, sizeof(Py_buffer));
    if (views == NULL)
        return (Py_buffer *)PyErr_NoMemory();
    for (Py_ssize_t got = 0; got < given; got++) {
        PyObject *arrays = PyTuple_GET_ITEM(tables, got);
        if (!PyTuple_Check(arrays))
            PyErr_SetString(PyExc_TypeError, "Expected a tuple of tuples of arrays");
        else if (get_arrays(&PyTuple_GET_ITEM(arrays, 0), PyTuple_GET_SIZE(arrays), kinds, count,
                            views + got * count))
            continue;
        release_tables(views, got, count);
        return NULL;
    }
    return views;
}

/* Tell whether numbers are not negative and below an end. */
static inline int are_within(const int64_t *numbers, Py_ssize_t count, int64_t end)
{
    uint64_t outside = 0; /* the highest bit tells: what is below 0, or beyond the last, has it */
    for (Py_ssize_t place = 0; place < count; place++)
        outside |= (uint64_t)numbers[place] | ((uint64_t)end - 1 - (uint64_t)numbers[place]);
    return !(outside >> 63);
}

/* Tell whether numbers increase from 0 to a last one, each by so much at the least. */
static inline int are_ends(const Py_buffer *ends, int64_t last, int64_t least)
{
    const int64_t *values = ends->buf;
    const Py_ssize_t count = ends->shape[0];
    if (count < 1 || values[0] != 0 || values[count - 1] != last)
        return 0;
    for (Py_ssize_t place = 1; place < count; place++)
        if (values[place] > last || values[place] < values[place - 1] + least)
            return 0;
    return 1;
}

#endif
