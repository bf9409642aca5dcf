/* What all modules of kernels have: their tables of functions, and how calls end. */

#ifndef MOMREC_MODULE_H
#define MOMREC_MODULE_H

#include "_arrays.h"

/* An entry of a module's METHODS: a function of the same name that takes an array of arguments. */
#define METHOD(name, text) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, text}

/* Define a module with METHODS. */
#define DEFINE_MODULE(name)                                               \
    static struct PyModuleDef MODULE = {                                  \
        PyModuleDef_HEAD_INIT, .m_name = #name, .m_size = 0, .m_methods = METHODS, \
    };                                                                    \
    PyMODINIT_FUNC PyInit_##name(void) { return PyModuleDef_Init(&MODULE); }

/* End a call: release the arrays, and return None or raise what was wrong. */
static inline PyObject *ended(Py_buffer *views, int count, int is_consistent, int fits,
                              const char *expected)
{
    release_arrays(views, count);
    if (!is_consistent)
        PyErr_SetString(PyExc_ValueError, expected);
    else if (!fits)
        PyErr_NoMemory();
    else
        Py_RETURN_NONE;
    return NULL;
}

#endif
