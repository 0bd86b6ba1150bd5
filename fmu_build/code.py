"""From a step to C: one self-contained piece of C99, everything static, that any shell can include.

It defines ``HS_NX``, ``HS_NU``, ``HS_NP``, ``HS_NY`` and::

    static int  hs_step(const double *x, const double *u, const double *p, double *xn, double *y);
    static void hs_start(const double *p, double *x);

``hs_step`` returns nonzero when an input or a result is not a number.  Tables stand before the step in the same unit,
so the compiler inlines their searches.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from halfshaft.fmu_build.compiler import shared_library
from halfshaft.library.tables import Table
from halfshaft.models.assembly import Step

_PRELUDE = """#include <math.h>
#ifndef casadi_int
#define casadi_int long long int
#endif
"""

_STEP = """
#define HS_NX {nx}
#define HS_NU {nu}
#define HS_NP {np}
#define HS_NY {ny}

static int hs_step(const double *x, const double *u, const double *p, double *xn, double *y) {{
  const double *arg[{sz_arg}];
  double *res[{sz_res}];
  double w[{sz_w}];
  casadi_int iw[{sz_iw}];
  arg[0] = x; arg[1] = u; arg[2] = p;
  res[0] = xn; res[1] = y;
  if ({name}_step(arg, res, iw, w, 0)) return 1;
  double check = 0;
  for (int i = 0; i < HS_NX; ++i) check += xn[i] * 0;
  for (int i = 0; i < HS_NU; ++i) check += u[i] * 0;
  return check != check;
}}

static void hs_start(const double *p, double *x) {{
  const double *arg[{start_arg}];
  double *res[{start_res}];
  double w[{start_w}];
  casadi_int iw[{start_iw}];
  arg[0] = p;
  res[0] = x;
  {name}_start(arg, res, iw, w, 0);
}}
"""


def table_library(named: Mapping[str, Table]) -> str:
    """Return C that exports tables in CasADi's calling convention."""
    head = _PRELUDE + '#define TABLE_META\n#define TABLE_EXPORT __attribute__((visibility("default")))\n'
    return head + "\n".join(t.c_source(name) for name, t in named.items())


def compiled_tables(named: Mapping[str, Table]) -> dict[str, ca.Function]:
    """Return tables as compiled functions, from the user's cache of libraries."""
    if not named:
        return {}
    library = str(shared_library(table_library(named), "tables"))
    return {name: ca.external(name, library) for name in named}


def step_code(step: Step) -> str:
    """Return the C of a step."""
    generator = ca.CodeGenerator(f"{step.name}.c", {"with_header": False, "mex": False, "main": False})
    generator.add(step.function)
    generator.add(step.start)
    tables = "\n".join(t.c_source(name) for name, t in step.tables.items())
    sizes = {
        "nx": len(step.states), "nu": len(step.requests), "np": len(step.parameters), "ny": len(step.outputs), "name": step.name,
        "sz_arg": step.function.sz_arg(), "sz_res": step.function.sz_res(),
        "sz_w": step.function.sz_w() + 1, "sz_iw": step.function.sz_iw() + 1,
        "start_arg": step.start.sz_arg(), "start_res": step.start.sz_res(),
        "start_w": step.start.sz_w() + 1, "start_iw": step.start.sz_iw() + 1,
    }  # fmt: skip
    head = _PRELUDE + "#define TABLE_EXPORT static inline\n#define CASADI_SYMBOL_EXPORT static\n"
    return head + tables + "\n" + generator.dump() + _STEP.format(**sizes)
