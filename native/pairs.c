/* Queries for one pair of bodies. In the usual case, a query is answered by a single call from Python. */

#include "single.h"

#include <math.h>
#include <string.h>

/* The data of the arrays ONE_PAIR (the steps of a `Plan` of `queries/pairs.py` for one pair) and NO_ROWS (see
   `_settle.py`), and the identity pose. */
static const int64_t one_pair[5] = {1, 0, 0, 0, 0}, no_rows[1];
static const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

#define ONE_PAIR ((Array2){one_pair, 5, 1})
#define NO_ROWS ((Array2){no_rows, 2, 0})

/* -- bodies and poses ---------------------------------------------------------------------------------------------- */

static PyObject *word_exact, *name_packed, *name_handle;

/* One side of a query: a body and its pose. */
typedef struct {
    PyObject *packed; /* This reference keeps the packed pieces alive, even if the body gets new ones. */
    int64_t handle;
    Array3 poses;
} Side;

static int take_pose(PyObject *given, Array3 *poses)
{
    *poses = (Array3){identity, 1, 4, 4};
    if (given == Py_None)
        return 1;
    if (!is_plain(given, 2))
        return 0;
    PyArrayObject *array = (PyArrayObject *)given;
    poses->data = PyArray_DATA(array);
    return PyArray_DIM(array, 0) == 4 && PyArray_DIM(array, 1) == 4;
}

/* Read a body, whose class must be exactly Body, and its pose; return false if the body or the pose is unusual. */
static int take_side(PyObject *class, PyObject *body, PyObject *pose, Side *side)
{
    side->packed = NULL;
    if ((PyObject *)Py_TYPE(body) != class || !take_pose(pose, &side->poses))
        return 0;
    side->packed = PyObject_GetAttr(body, name_packed);
    PyObject *handle = side->packed == NULL ? NULL : PyObject_GetAttr(side->packed, name_handle);
    side->handle = handle == NULL ? -1 : PyLong_AsLongLong(handle);
    Py_XDECREF(handle);
    if (side->handle != -1)
        return 1;
    PyErr_Clear();
    return 0;
}

static int take_sides(PyObject *class, PyObject *const *given, Side *a, Side *b)
{
    b->packed = NULL;
    return take_side(class, given[0], given[1], a) && take_side(class, given[2], given[3], b);
}

static void leave_sides(Side *a, Side *b)
{
    Py_XDECREF(a->packed);
    Py_XDECREF(b->packed);
}

static int take_margin(PyObject *given, double *margin)
{
    if (!PyFloat_CheckExact(given))
        return 0;
    *margin = PyFloat_AsDouble(given);
    return *margin >= 0 && *margin < INFINITY;
}

/* Return the number of pieces of a body. This is the number of rows of the first array in the table to which the body's
   handle points (see `records.py`). */
static int64_t piece_count(const Side *side)
{
    return ((const int64_t *)side->handle)[1];
}

static int is_long(const Side *a, const Side *b)
{
    return piece_count(a) * piece_count(b) > MANY;
}

/* -- verdicts ------------------------------------------------------------------------------------------------------ */

typedef struct {
    Holder holder;
    Function settle_range, distance_range, measure_left, first_fault;
    void (*release)(void *);
    long long settle_memory, distance_memory; /* Bytes that `settle_range` and `distance_range` need. */
} Pairs;

/* Return the verdict for two bodies; -1 if Python's general code has to answer. */
static int settled(const Pairs *self, int mode, double margin, const Side *a, const Side *b)
{
    int8_t verdict = CODE_AMBIGUOUS;
    int64_t tally[CODE_TIERS] = {0}, are_rigid = 0;
    struct settle_range arguments = {
        .mode = mode, .margin = margin, .stop = 1, .plan = ONE_PAIR, .rows = NO_ROWS, .pack_a = a->handle,
        .Ta = a->poses, .pack_b = b->handle, .Tb = b->poses, .out = {&verdict, 1}, .tally = {tally, CODE_TIERS},
        .memory = thread_memory(self->settle_memory),
    };
    if (arguments.memory == NULL || call_kernel(self->settle_range, &arguments, &are_rigid, is_long(a, b)) != 0 ||
        !(are_rigid & 1))
        return -1;
    /* In the mode EXACT, pairs that the fast searches leave open are settled by a slower fallback in Python. */
    return mode == CODE_EXACT && (tally[CODE_OPEN] != 0 || verdict == CODE_AMBIGUOUS) ? -1 : verdict;
}

/* Answer a query about two bodies at poses. The first argument is the class Body; the bodies and their poses follow. */
static PyObject *answer(const Pairs *self, int mode, PyObject *const *given, PyObject *margin, PyObject *pairs)
{
    Side a, b;
    double least;
    if (pairs != Py_None || !take_margin(margin, &least))
        Py_RETURN_NONE;
    int verdict = take_sides(given[0], given + 1, &a, &b) ? settled(self, mode, least, &a, &b) : -1;
    leave_sides(&a, &b);
    return answer_of(mode, verdict);
}

/* collide(Body, a, T_world_a, b, T_world_b, method, margin, pairs) returns a bool, or None if Python's general code has
   to answer. */
static PyObject *pairs_collide(Pairs *self, PyObject *const *given, Py_ssize_t count)
{
    if (count != 8 || (given[5] != word_exact &&
                       !(PyUnicode_CheckExact(given[5]) && PyUnicode_Compare(given[5], word_exact) == 0)))
        Py_RETURN_NONE;
    return answer(self, CODE_EXACT, given, given[6], given[7]);
}

/* classify(Body, a, T_world_a, b, T_world_b, margin, pairs) returns the number of a verdict, or None if Python's
   general code has to answer. */
static PyObject *pairs_classify(Pairs *self, PyObject *const *given, Py_ssize_t count)
{
    if (count != 7)
        Py_RETURN_NONE;
    return answer(self, CODE_CERTIFY, given, given[5], given[6]);
}

/* -- distances ----------------------------------------------------------------------------------------------------- */

/* Indices of the fields of a `loewner.Distance`, in the order in which the class lists them: first numbers, then
   vectors. */
enum { LOWER, UPPER, ESTIMATE, VALUE, NUMBERS };
enum { WITNESS_A, WITNESS_B, NORMAL, VECTORS };
static const char *const field_texts[NUMBERS + VECTORS] = {
    "lower", "upper", "estimate", "distance", "witness_a", "witness_b", "normal",
};
static PyObject *field_names[NUMBERS + VECTORS], *no_arguments;
static newfunc new_of_object; /* The function object.__new__. */

typedef struct {
    double number[NUMBERS], vector[VECTORS][3];
} Found;

static int is_rigid(const Pairs *self, const Array3 *poses)
{
    struct first_fault_results fault;
    return poses->data == identity ||
           (self->first_fault((const int64_t *)poses, (int64_t *)&fault) == 0 && fault.k == poses->count);
}

/* Compute the distances of the piece pairs that the fast searches left open; return whether this succeeded. */
static int finished(const Pairs *self, const struct distance_range *asked, const struct distance_range_results *left)
{
    struct measure_left arguments = {
        .pieces = left->pieces.array, .values = left->values.array, .pack_a = asked->pack_a, .Ta = asked->Ta,
        .pack_b = asked->pack_b, .Tb = asked->Tb, .numbers = asked->numbers, .vectors = asked->vectors,
        .status = asked->status,
    };
    int64_t nothing;
    return left->pieces.array.rows == 0 || call_kernel(self->measure_left, &arguments, &nothing, 1) == 0;
}

/* Compute a Distance's fields for two bodies at rigid poses; return false if Python's general code has to answer. */
static int measured(const Pairs *self, int wanted, const Side *a, const Side *b, Found *found)
{
    int8_t status = 0;
    struct distance_range_results left;
    double *number = found->number;
    struct distance_range arguments = {
        .wanted = wanted, .stop = 1, .plan = ONE_PAIR, .rows = NO_ROWS, .pack_a = a->handle, .Ta = a->poses,
        .pack_b = b->handle, .Tb = b->poses, .memory = thread_memory(self->distance_memory),
        .numbers = {number, VALUE + wanted, 1}, .vectors = {found->vector, VECTORS, wanted, 3},
        .status = {&status, wanted},
    };
    if (arguments.memory == NULL || call_kernel(self->distance_range, &arguments, &left, is_long(a, b)) != 0)
        return 0;
    int is_whole = finished(self, &arguments, &left) && status == 0;
    self->release(left.pieces.memory);
    self->release(left.values.memory);
    if (!is_whole || !isfinite(number[LOWER]) || !isfinite(number[UPPER]) || !isfinite(number[ESTIMATE]))
        return 0;
    if (!wanted)
        return 1;
    if (!isfinite(number[VALUE]))
        return 0;
    /* The bounds are proven, but the value may have rounding errors. A value outside the bounds is therefore replaced
       by the nearest bound. */
    number[VALUE] = fmax(number[LOWER], fmin(number[VALUE], number[UPPER]));
    return number[VALUE] != 0; /* Zeros are left to Python, because NumPy decides their sign. */
}

static PyObject *vector_of(const double *entries)
{
    npy_intp length = 3;
    PyObject *array = PyArray_SimpleNew(1, &length, NPY_DOUBLE);
    if (array != NULL)
        memcpy(PyArray_DATA((PyArrayObject *)array), entries, 3 * sizeof *entries);
    return array;
}

/* Return the value of a Distance's field with a given index; None if the field was not requested. */
static PyObject *field_of(const Found *found, int place, int wanted)
{
    if (place >= VALUE && !wanted)
        return Py_NewRef(Py_None);
    return place < NUMBERS ? PyFloat_FromDouble(found->number[place]) : vector_of(found->vector[place - NUMBERS]);
}

/* Make a Distance with these fields. The class is frozen, so its own method for setting attributes is bypassed. */
static PyObject *distance_of(PyObject *class, const Found *found, int wanted)
{
    PyObject *made = new_of_object((PyTypeObject *)class, no_arguments, NULL);
    for (int place = 0; made != NULL && place < NUMBERS + VECTORS; place++) {
        PyObject *field = field_of(found, place, wanted);
        if (field == NULL || PyObject_GenericSetAttr(made, field_names[place], field) < 0)
            Py_CLEAR(made);
        Py_XDECREF(field);
    }
    return made;
}

/* distance(Body, Distance, a, T_world_a, b, T_world_b, exact, pairs) returns a Distance, or None if Python's general
   code has to answer. */
static PyObject *pairs_distance(Pairs *self, PyObject *const *given, Py_ssize_t count)
{
    Side a, b;
    Found found;
    if (count != 8 || given[7] != Py_None || !PyBool_Check(given[6]) || !PyType_Check(given[1]))
        Py_RETURN_NONE;
    int wanted = given[6] == Py_True;
    int is_found = take_sides(given[0], given + 2, &a, &b) && is_rigid(self, &a.poses) && is_rigid(self, &b.poses) &&
                   measured(self, wanted, &a, &b, &found);
    leave_sides(&a, &b);
    PyObject *made = is_found ? distance_of(given[1], &found, wanted) : NULL;
    if (made != NULL)
        return made;
    PyErr_Clear(); /* If memory has run out, Python's general code tries again. */
    Py_RETURN_NONE;
}

/* -- the type ------------------------------------------------------------------------------------------------------ */

static PyObject *pairs_new(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    PyObject *settle, *distance, *left, *fault;
    static char *known[] = {
        "settle_range", "distance_range", "measure_left", "first_fault", "settle_memory", "distance_memory", NULL,
    };
    Pairs *made = new_object(type);
    if (made == NULL || !PyArg_ParseTupleAndKeywords(arguments, names, "OOOOLL", known, &settle, &distance, &left,
                                                     &fault, &made->settle_memory, &made->distance_memory)) {
        Py_CLEAR(made);
        return NULL;
    }
    made->settle_range = function_of(settle, SETTLE_RANGE_WORDS);
    made->distance_range = function_of(distance, DISTANCE_RANGE_WORDS);
    made->measure_left = function_of(left, MEASURE_LEFT_WORDS);
    made->first_fault = function_of(fault, FIRST_FAULT_WORDS);
    if (!PyErr_Occurred()) {
        made->release = kernel_of(distance)->release;
        made->holder.held = PyTuple_Pack(4, settle, distance, left, fault);
    }
    if (made->holder.held == NULL)
        Py_CLEAR(made);
    return (PyObject *)made;
}

static PyMethodDef pairs_methods[] = {
    FAST_METHOD("collide", pairs_collide, "collide(Body, a, T_world_a, b, T_world_b, method, margin, pairs)"),
    FAST_METHOD("classify", pairs_classify, "classify(Body, a, T_world_a, b, T_world_b, margin, pairs)"),
    FAST_METHOD("distance", pairs_distance, "distance(Body, Distance, a, T_world_a, b, T_world_b, exact, pairs)"),
    {NULL, NULL, 0, NULL},
};

int add_pairs(PyObject *module)
{
    word_exact = PyUnicode_InternFromString("exact");
    name_packed = PyUnicode_InternFromString("_packed");
    name_handle = PyUnicode_InternFromString("handle");
    no_arguments = PyTuple_New(0);
    new_of_object = (newfunc)PyType_GetSlot(&PyBaseObject_Type, Py_tp_new);
    for (int place = 0; place < NUMBERS + VECTORS; place++)
        field_names[place] = PyUnicode_InternFromString(field_texts[place]);
    return PyErr_Occurred() ? -1
                            : add_holder(module, "loewner._native._call.Pairs",
                                         "Queries of one pair of bodies; made by `singles.py`.", sizeof(Pairs),
                                         pairs_new, pairs_methods);
}
