/* A tick from Python objects to Python objects: what Engine.step does where nothing is unusual.
 *
 * What it does not know, it leaves to Python: it returns a number instead of a result.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

#include "tick.h"

#define NOT_LOADED (-1)

/* Where an input of a task goes: column by column. */
typedef struct {
    double *to;
    int dimensions;
    npy_intp rows, columns;
} place;

typedef int (*solver)(const qpctrl_tick *);

typedef struct {
    const qpctrl_tick *tick;
    solver solve;      /* qpctrl_solve of the library that made the tick */
    PyObject *owner;   /* of the memory behind all pointers */
    PyObject *places;  /* task -> input -> place, as bytes */
    PyObject *mode, *format, *sizes, *ok, *no_rows, *arrays, *closed;
    PyTypeObject *command, *report, *memory;
    const double *numbers; /* all that a tick leaves behind */
    npy_intp size, remembered;
    int has_rows;
} binding;

/* Fields of Measurement and Memory. */
enum { TIME, Q, V, CONTACT, MEASURED };
enum { MODE, PACKED, SIZES, LAST_TIME, LAST_CONTACT, FREEZE, FALLBACK_TICKS, REMEMBERED };

static int take(PyObject *object, const place *p)
{
    if (!PyArray_CheckExact(object)) {
        return 0;
    }
    PyArrayObject *array = (PyArrayObject *)object;
    const npy_intp *shape = PyArray_DIMS(array), *stride = PyArray_STRIDES(array);
    const int n = PyArray_NDIM(array);
    if (n != p->dimensions || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISBEHAVED_RO(array) ||
        (n > 0 && shape[0] != p->rows) || (n > 1 && shape[1] != p->columns)) {
        return 0;
    }
    const char *from = PyArray_BYTES(array);
    double *to = p->to;
    for (npy_intp j = 0; j < p->columns; ++j) {
        const char *at = n > 1 ? from + j * stride[1] : from;
        for (npy_intp i = 0; i < p->rows; ++i) {
            *to++ = *(const double *)at;
            at += n > 0 ? stride[0] : 0;
        }
    }
    return 1;
}

static int take_vector(PyObject *object, double *to, npy_intp size)
{
    const place p = {to, 1, size, 1};
    return take(object, &p);
}

/* Take the first numbers of a vector that may be longer. */
static int take_front(PyObject *object, double *to, npy_intp size)
{
    if (!PyArray_CheckExact(object)) {
        return 0;
    }
    PyArrayObject *array = (PyArrayObject *)object;
    if (PyArray_NDIM(array) != 1 || PyArray_TYPE(array) != NPY_DOUBLE ||
        !PyArray_ISCARRAY_RO(array) || PyArray_DIM(array, 0) < size) {
        return 0;
    }
    memcpy(to, PyArray_DATA(array), (size_t)size * sizeof *to);
    return 1;
}

/* Write what a task shall follow into the buffers. */
static int refer(const binding *b, PyObject *task, PyObject *reference)
{
    PyObject *places = PyDict_GetItemWithError(b->places, task);
    PyObject *arrays = places ? PyObject_GetAttr(reference, b->arrays) : NULL;
    int taken = arrays && PyDict_CheckExact(arrays);
    PyObject *name, *value;
    for (Py_ssize_t i = 0; taken && PyDict_Next(arrays, &i, &name, &value);) {
        PyObject *bytes = PyDict_GetItemWithError(places, name);
        taken = bytes && take(value, (const place *)PyBytes_AS_STRING(bytes));
    }
    Py_XDECREF(arrays);
    return taken;
}

static int load(const binding *b, PyObject *measurement, PyObject *references, PyObject *memory)
{
    const qpctrl_tick *t = b->tick;
    if (!(PyTuple_Check(measurement) && PyTuple_GET_SIZE(measurement) == MEASURED &&
          PyDict_CheckExact(references) && PyTuple_Check(memory) &&
          PyTuple_GET_SIZE(memory) == REMEMBERED)) {
        return 0;
    }
    if (!(take_vector(PyTuple_GET_ITEM(measurement, Q), t->q, t->nq) &&
          take_vector(PyTuple_GET_ITEM(measurement, V), t->v, t->nv) &&
          take_front(PyTuple_GET_ITEM(memory, PACKED), t->last, b->remembered))) {
        return 0;
    }
    PyObject *const time = PyTuple_GET_ITEM(measurement, TIME);
    PyObject *const freeze = PyTuple_GET_ITEM(memory, FREEZE);
    if (!PyFloat_Check(time) || !PyBool_Check(freeze)) {
        return 0;
    }
    t->clock[0] = PyFloat_AsDouble(time);
    t->clock[1] = PyFloat_AsDouble(PyTuple_GET_ITEM(memory, LAST_TIME));
    t->clock[2] = freeze == Py_True;
    if (PyTuple_GET_ITEM(memory, MODE) != b->mode || t->clock[1] == -Py_HUGE_VAL) {
        return 0; /* the first tick, or another mode: Python carries over what both remember */
    }
    PyObject *task, *reference;
    for (Py_ssize_t i = 0; PyDict_Next(references, &i, &task, &reference);) {
        if (!refer(b, task, reference)) {
            return 0;
        }
    }
    return !PyErr_Occurred();
}

static PyObject *view(PyObject *numbers, npy_intp size)
{
    void *data = PyArray_DATA((PyArrayObject *)numbers);
    PyObject *part = PyArray_SimpleNewFromData(1, &size, NPY_DOUBLE, data);
    if (part) {
        Py_INCREF(numbers); /* the view takes possession of it, whatever comes of it */
        if (PyArray_SetBaseObject((PyArrayObject *)part, numbers) < 0) {
            Py_CLEAR(part);
        }
    }
    return part;
}

/* A named tuple of `count` items, of which it takes possession; NULL if one of them is. */
static PyObject *named(PyTypeObject *type, Py_ssize_t count, PyObject *const *items)
{
    PyObject *made = type->tp_alloc(type, count);
    int whole = made != NULL;
    for (Py_ssize_t i = 0; i < count; ++i) {
        whole = whole && items[i];
        if (made) {
            PyTuple_SET_ITEM(made, i, items[i]);
        } else {
            Py_XDECREF(items[i]);
        }
    }
    if (!whole) {
        Py_CLEAR(made);
    }
    return made;
}

static PyObject *kept(PyObject *object)
{
    Py_INCREF(object);
    return object;
}

static PyObject *result(const binding *b, int limited, PyObject *measurement, PyObject *memory)
{
    PyObject *contact = PyTuple_GET_ITEM(measurement, CONTACT);
    PyObject *numbers = PyArray_SimpleNew(1, &b->size, NPY_DOUBLE);
    PyObject *closed = b->has_rows ? PyObject_GetAttr(contact, b->closed) : kept(Py_True);
    if (!numbers || !closed) {
        Py_XDECREF(numbers);
        Py_XDECREF(closed);
        return NULL;
    }
    memcpy(PyArray_DATA((PyArrayObject *)numbers), b->numbers, (size_t)b->size * sizeof(double));
    const int freeze = limited || closed != Py_True;
    Py_DECREF(closed);
    PyObject *command[] = {view(numbers, b->tick->nu), kept(Py_False)};
    PyObject *report[] = {kept(b->format), numbers,
                          kept(b->ok),     kept(contact),
                          PyBool_FromLong(limited), kept(b->no_rows)};
    PyObject *after[] = {kept(b->mode),
                         kept(numbers),
                         kept(b->sizes),
                         kept(PyTuple_GET_ITEM(measurement, TIME)),
                         kept(contact),
                         PyBool_FromLong(freeze),
                         kept(PyTuple_GET_ITEM(memory, FALLBACK_TICKS))};
    PyObject *parts[] = {named(b->command, 2, command), named(b->report, 6, report),
                         named(b->memory, REMEMBERED, after)};
    return named(&PyTuple_Type, 3, parts);
}

/* The tick of (measurement, references, memory), or a number: why Python shall look at it. */
static PyObject *ticked(const binding *b, PyObject *const *args)
{
    if (!load(b, args[0], args[1], args[2])) {
        return PyErr_Occurred() ? NULL : PyLong_FromLong(NOT_LOADED);
    }
    const int code = b->solve(b->tick);
    return code > QPCTRL_LIMITED ? PyLong_FromLong(code)
                                 : result(b, code == QPCTRL_LIMITED, args[0], args[2]);
}

static PyObject *step(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const binding *b = PyCapsule_GetPointer(self, NULL);
    return count == 3 ? ticked(b, args) : PyLong_FromLong(NOT_LOADED);
}

/* Controller.step where its mode is bound and all is usual; `given`: mode -> bound step, and
 * what takes (code, mode, measurement, references, memory) where it is not. */
static PyObject *dispatch(PyObject *given, PyObject *const *args, Py_ssize_t count, PyObject *names)
{
    PyObject *const steps = PyTuple_GET_ITEM(given, 0), *const slow = PyTuple_GET_ITEM(given, 1);
    const Py_ssize_t named_count = names ? PyTuple_GET_SIZE(names) : 0;
    PyObject *code = NULL;
    if (count == 4 && named_count == 0) {
        PyObject *bound = PyDict_GetItemWithError(steps, args[0]);
        if (bound) {
            PyObject *done = ticked(PyCapsule_GetPointer(PyCFunction_GET_SELF(bound), NULL), args + 1);
            if (!done || !PyLong_Check(done)) {
                return done;
            }
            code = done;
        } else if (PyErr_Occurred()) {
            PyErr_Clear(); /* no name at all; Python says so */
        }
    }
    if (!code && !(code = PyLong_FromLong(NOT_LOADED))) {
        return NULL;
    }
    PyObject *all[9] = {code};
    if (count + named_count > 8) {
        Py_DECREF(code);
        PyErr_SetString(PyExc_TypeError, "step: takes mode, measurement, references, memory");
        return NULL;
    }
    for (Py_ssize_t i = 0; i < count + named_count; ++i) {
        all[i + 1] = args[i];
    }
    PyObject *done = PyObject_Vectorcall(slow, all, (size_t)count + 1, names);
    Py_DECREF(code);
    return done;
}

static void unbind(PyObject *capsule)
{
    binding *b = PyCapsule_GetPointer(capsule, NULL);
    PyObject *owned[] = {b->owner, b->places,  b->mode,   b->format, b->sizes,
                         b->ok,    b->no_rows, b->arrays, b->closed,
                         (PyObject *)b->command, (PyObject *)b->report, (PyObject *)b->memory};
    for (size_t i = 0; i < sizeof owned / sizeof *owned; ++i) {
        Py_XDECREF(owned[i]);
    }
    PyMem_Free(b);
}

/* Return step(measurement, references, memory) for a tick.
 *
 * `given`: owner, places, mode, format, sizes, Status.OK, types Command, TickReport and Memory, address
 * and length of the numbers, length of what is remembered, whether the mode has rows. */
PyObject *qpctrl_bind(const qpctrl_tick *tick, solver solve, PyObject *given)
{
    static PyMethodDef definition = {"step", (PyCFunction)(void (*)(void))step, METH_FASTCALL,
                                     "Run one tick."};
    if (!PyArray_API && _import_array() < 0) {
        return NULL;
    }
    binding *b = PyMem_Calloc(1, sizeof *b);
    Py_ssize_t address, size, remembered;
    if (!b || !PyArg_ParseTuple(given, "OOOOOOOOOnnnp", &b->owner, &b->places, &b->mode, &b->format,
                                &b->sizes, &b->ok, &b->command, &b->report, &b->memory, &address, &size,
                                &remembered, &b->has_rows)) {
        PyMem_Free(b);
        return NULL;
    }
    b->tick = tick, b->solve = solve, b->numbers = (const double *)address;
    b->size = size, b->remembered = remembered;
    PyObject *borrowed[] = {b->owner, b->places, b->mode, b->format, b->sizes, b->ok,
                            (PyObject *)b->command, (PyObject *)b->report, (PyObject *)b->memory};
    for (size_t i = 0; i < sizeof borrowed / sizeof *borrowed; ++i) {
        Py_INCREF(borrowed[i]);
    }
    b->no_rows = PyTuple_New(0);
    b->arrays = PyUnicode_InternFromString("arrays");
    b->closed = PyUnicode_InternFromString("closed");
    PyObject *capsule = PyCapsule_New(b, NULL, unbind);
    PyObject *function = capsule ? PyCFunction_New(&definition, capsule) : NULL;
    Py_XDECREF(capsule);
    return function;
}

/* Return step(mode, measurement, references, memory) of a controller; `given` as in `dispatch`. */
PyObject *qpctrl_dispatch(PyObject *given)
{
    static PyMethodDef definition = {"step", (PyCFunction)(void (*)(void))dispatch,
                                     METH_FASTCALL | METH_KEYWORDS, "Run one tick."};
    return PyCFunction_New(&definition, given);
}
