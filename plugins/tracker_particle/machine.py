"""LLVM text around step programs: what a pass is given, its draws, ancestors, and steps one after the other.

What a pass computes is composed in `kernels`; when machine code is used is decided there and in
`records`. Everything here does exactly what the arrays of `draws`, `resampling` and `propagation` do.
"""

from __future__ import annotations

import functools

from tracker.compile.llvm import emit
from tracker.compile.program import WIDTH, Program, Rate
from tracker.models.functions import exp
from tracker_particle import draws

_PLACES = {
    "x": "points", "moved": "points", "weight": "weights", "a": "drawn", "b": "drawn",
    "given": "given", "log": "drawn", "real": "drawn",
}  # fmt: skip
"""Where the rows of a step lie, by what they are called; those of other names are written to ``out``."""


_MATRICES = ("points", "weights", "drawn", "given", "out", "left")


def entry(program: Program, constants: int, sums: int, found: int) -> list[str]:
    """LLVM text of ``void run(N, key, key, word, points, weights, drawn, given, out, left)``.

    It draws the uniforms, says where the rows of the step lie in matrices, adds up the eight parts of its sums, and hands
    them to the conclusion.
    """
    wide_ = f"<{WIDTH} x double>"
    pointers = ", ".join(f"ptr %{name}" for name in _MATRICES)
    lines = [
        f"declare double @llvm.vector.reduce.fadd.v{WIDTH}f64(double, {wide_})",
        f"define void @run(i64 %N, i64 %k1, i64 %k2, i64 %word, {pointers}) {{",
        "entry:",
        f"  %groups = sdiv i64 %N, {WIDTH}",
    ]
    half = sum(name.startswith("a") for name in program.inputs)
    for name, size in (
        ("constants", constants * WIDTH), ("sums", sums * WIDTH), ("found", found * WIDTH),
        ("constants.one", constants), ("sums.one", sums),
    ):  # fmt: skip
        lines.append(f"  %a.{name} = alloca [{size} x double], align 64")
    lines.append(f"  store [{sums * WIDTH} x double] zeroinitializer, ptr %a.sums, align 64")
    if half:
        lines += uniforms(2 * half)
    arguments = []
    for name in program.shapes(1, 1):
        pointer = f"%a.{name}"
        if name not in program.states:
            kind = name.rstrip("0123456789")
            row = int(name[len(kind) :] or 0) + (half if kind == "b" else 0)
            lines.append(f"  %o.{name} = mul i64 %N, {row}")
            base = f"%{_PLACES.get(kind, 'out')}"
            lines.append(f"  {pointer} = getelementptr inbounds double, ptr {base}, i64 %o.{name}")
        arguments.append(f"ptr {pointer}")
    lines.append(f"  call void @step(i64 0, i64 1, i64 %groups, {', '.join(arguments)})")

    def moved(kind: str, count: int, target: str, *, added: bool) -> None:
        for i in range(count):
            at = f"{kind}.{i}"
            lines.append(
                f"  %f.{at} = getelementptr inbounds double, ptr %a.{kind}, i64 {i * WIDTH}"
            )
            if added:
                lines.append(f"  %w.{at} = load {wide_}, ptr %f.{at}, align 8")
                add = f"call double @llvm.vector.reduce.fadd.v{WIDTH}f64(double -0.0, {wide_} %w.{at})"
                lines.append(f"  %v.{at} = {add}")
            else:
                lines.append(f"  %v.{at} = load double, ptr %f.{at}, align 8")
            lines.append(f"  %t.{at} = getelementptr inbounds double, ptr {target}, i64 {i}")
            lines.append(f"  store double %v.{at}, ptr %t.{at}, align 8")

    moved("constants", constants, "%a.constants.one", added=False)
    moved("sums", sums, "%a.sums.one", added=True)
    lines.append(
        "  call void @last(i64 0, i64 1, i64 1, ptr %a.constants.one, ptr %a.sums.one, ptr %given, "
        "ptr %a.found)"
    )
    moved("found", found, "%left", added=False)
    return [*lines, "  ret void", "}"]


def uniforms(rows: int) -> list[str]:
    """LLVM text that fills ``rows`` of N uniforms: `draws.normals` before it makes normals of them.

    Reference:
        Doty-Humphrey, PractRand, sfc.h (SFC64), eight of it side by side.
    """
    v = f"<{draws.STREAMS} x i64>"
    places = ", ".join(f"i64 {i}" for i in range(draws.STREAMS))

    def splat(name: str, value: str) -> list[str]:
        everywhere = f"<{draws.STREAMS} x i32> zeroinitializer"
        return [
            f"  %{name}.one = insertelement {v} poison, i64 {value}, i32 0",
            f"  %{name} = shufflevector {v} %{name}.one, {v} poison, {everywhere}",
        ]

    def all_(number: int) -> str:
        return f"<{', '.join([f'i64 {number}'] * draws.STREAMS)}>"

    unit = f"<{', '.join(['double 0x3CA0000000000000'] * WIDTH)}>"  # 2**-53
    return [
        *splat("seed.a", "%k1"),
        *splat("seed.b", "%k2"),
        *splat("seed.word", "%word"),
        f"  %seed.c = add {v} %seed.word, <{places}>",
        f"  %numbers = mul i64 %groups, {rows}",
        "  br label %draw",
        "draw:",
        f"  %i = phi i64 [-{draws.MIXING}, %entry], [%i.next, %drawn.one]",
        f"  %a = phi {v} [%seed.a, %entry], [%a.next, %drawn.one]",
        f"  %b = phi {v} [%seed.b, %entry], [%b.next, %drawn.one]",
        f"  %c = phi {v} [%seed.c, %entry], [%c.next, %drawn.one]",
        f"  %w = phi {v} [{all_(1)}, %entry], [%w.next, %drawn.one]",
        "  %row = phi i64 [0, %entry], [%row.next, %drawn.one]",
        "  %column = phi i64 [0, %entry], [%column.next, %drawn.one]",
        f"  %ab = add {v} %a, %b",
        f"  %new = add {v} %ab, %w",
        f"  %w.next = add {v} %w, {all_(1)}",
        f"  %b.low = lshr {v} %b, {all_(11)}",
        f"  %a.next = xor {v} %b, %b.low",
        f"  %c.high = shl {v} %c, {all_(3)}",
        f"  %b.next = add {v} %c, %c.high",
        f"  %c.up = shl {v} %c, {all_(24)}",
        f"  %c.down = lshr {v} %c, {all_(40)}",
        f"  %c.turned = or {v} %c.up, %c.down",
        f"  %c.next = add {v} %c.turned, %new",
        "  %mixed = icmp sge i64 %i, 0",
        "  br i1 %mixed, label %keep, label %drawn.one",
        "keep:",
        "  %row.start = mul i64 %row, %N",
        "  %place = add i64 %row.start, %column",
        "  %to = getelementptr inbounds double, ptr %drawn, i64 %place",
        f"  %bits = lshr {v} %new, {all_(11)}",
        f"  %whole = uitofp {v} %bits to <{WIDTH} x double>",
        f"  %unit = fmul <{WIDTH} x double> %whole, {unit}",
        f"  store <{WIDTH} x double> %unit, ptr %to, align 8",
        "  %row.after = add i64 %row, 1",
        f"  %whole.group = icmp eq i64 %row.after, {rows}",
        "  %row.new = select i1 %whole.group, i64 0, i64 %row.after",
        f"  %column.after = add i64 %column, {WIDTH}",
        "  %column.new = select i1 %whole.group, i64 %column.after, i64 %column",
        "  br label %drawn.one",
        "drawn.one:",
        "  %row.next = phi i64 [0, %draw], [%row.new, %keep]",
        "  %column.next = phi i64 [0, %draw], [%column.new, %keep]",
        "  %i.next = add i64 %i, 1",
        "  %done = icmp sge i64 %i.next, %numbers",
        "  br i1 %done, label %pass, label %draw",
        "pass:",
    ]


# ---------------------------------------------------------------------------------- ancestors
_ONE = "0x3CA0000000000000"  # 2**-53
_MOST = "0x3FEFFFFFFF768FA1"  # 1 - 1e-9, as `resampling.Systematic` bounds its uniform


@functools.cache
def choosing() -> str:
    """LLVM text of ``void run(count, N, rows, key, key, word, log_weights, points, scratch, out)``.

    Systematic resampling: ``out`` are the chosen of ``points (rows, N)``, by the first ``count`` of their
    log weights; what fills up to N repeats the last. Scratch holds 3 N + 8 numbers.

    Reference:
        `resampling.Systematic`, `draws.uniforms`.
    """
    program = Program()
    program.history("weight", [exp(program.input("log", 1, Rate.BOTH)[0])])
    text = emit(program).replace("define void @run(", "define internal void @weigh(", 1)
    v, pointers = f"<{WIDTH} x double>", f"<{WIDTH} x ptr>"
    everywhere = ", ".join(["i1 true"] * WIDTH)
    gathered = f"@llvm.masked.gather.v{WIDTH}f64.v{WIDTH}p0"
    lines = [
        "declare double @llvm.ceil.f64(double)",
        "declare i64 @llvm.fptosi.sat.i64.f64(double)",
        "declare i64 @llvm.umin.i64(i64, i64)",
        "declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)",
        f"declare {v} {gathered}({pointers}, i32, <{WIDTH} x i1>, {v})",
        (
            "define void @run(i64 %count, i64 %N, i64 %rows, i64 %k1, i64 %k2, i64 %word, ptr %log, "
            "ptr %points, ptr %weights, ptr %out) {"
        ),
        "entry:",
        f"  %groups = sdiv i64 %N, {WIDTH}",
        "  call void @weigh(i64 0, i64 1, i64 %groups, ptr %log, ptr %weights)",
        "  %below = getelementptr inbounds double, ptr %weights, i64 %N",
        "  %begun = getelementptr inbounds double, ptr %below, i64 %N",
        "  %size = mul i64 %N, 8",
        "  %room = add i64 %size, 8",
        "  call void @llvm.memset.p0.i64(ptr %begun, i8 0, i64 %room, i1 false)",
        "  br label %draw",
        "draw:",
        "  %i = phi i64 [0, %entry], [%i.next, %draw]",
        "  %a = phi i64 [%k1, %entry], [%a.next, %draw]",
        "  %b = phi i64 [%k2, %entry], [%b.next, %draw]",
        "  %c = phi i64 [%word, %entry], [%c.next, %draw]",
        "  %w = phi i64 [1, %entry], [%w.next, %draw]",
        "  %ab = add i64 %a, %b",
        "  %new = add i64 %ab, %w",
        "  %w.next = add i64 %w, 1",
        "  %b.low = lshr i64 %b, 11",
        "  %a.next = xor i64 %b, %b.low",
        "  %c.high = shl i64 %c, 3",
        "  %b.next = add i64 %c, %c.high",
        "  %c.up = shl i64 %c, 24",
        "  %c.down = lshr i64 %c, 40",
        "  %c.turned = or i64 %c.up, %c.down",
        "  %c.next = add i64 %c.turned, %new",
        "  %i.next = add i64 %i, 1",
        f"  %drawn = icmp sgt i64 %i.next, {draws.MIXING}",
        "  br i1 %drawn, label %uniform, label %draw",
        "uniform:",
        "  %bits = lshr i64 %new, 11",
        "  %whole = uitofp i64 %bits to double",
        f"  %any = fmul double %whole, {_ONE}",
        f"  %high = fcmp ogt double %any, {_MOST}",
        f"  %u = select i1 %high, double {_MOST}, double %any",
        "  br label %sum",
        "sum:",
        "  %s = phi i64 [0, %uniform], [%s.next, %sum]",
        "  %total = phi double [-0.0, %uniform], [%total.next, %sum]",
        "  %s.weight = getelementptr inbounds double, ptr %weights, i64 %s",
        "  %s.own = load double, ptr %s.weight, align 8",
        "  %total.next = fadd double %total, %s.own",
        "  %s.below = getelementptr inbounds double, ptr %below, i64 %s",
        "  store double %total.next, ptr %s.below, align 8",
        "  %s.next = add i64 %s, 1",
        "  %summed = icmp sge i64 %s.next, %count",
        "  br i1 %summed, label %comb, label %sum",
        "comb:",
        "  %teeth = sitofp i64 %count to double",
        "  %pitch = fdiv double %teeth, %total.next",
        "  %last = sub i64 %count, 1",
        "  br label %place",
        "place:",
        "  %p = phi i64 [0, %comb], [%p.next, %place]",
        "  %p.below = getelementptr inbounds double, ptr %below, i64 %p",
        "  %p.own = load double, ptr %p.below, align 8",
        "  %p.scaled = fmul double %p.own, %pitch",
        "  %p.moved = fsub double %p.scaled, %u",
        "  %p.up = call double @llvm.ceil.f64(double %p.moved)",
        "  %p.whole = call i64 @llvm.fptosi.sat.i64.f64(double %p.up)",
        "  %p.copies = call i64 @llvm.umin.i64(i64 %p.whole, i64 %count)",
        "  %p.begun = getelementptr inbounds i64, ptr %begun, i64 %p.copies",
        "  %p.before = load i64, ptr %p.begun, align 8",
        "  %p.after = add i64 %p.before, 1",
        "  store i64 %p.after, ptr %p.begun, align 8",
        "  %p.next = add i64 %p, 1",
        "  %placed = icmp sge i64 %p.next, %count",
        "  br i1 %placed, label %name, label %place",
        "name:",
        "  %n = phi i64 [0, %place], [%n.next, %name]",
        "  %gone = phi i64 [0, %place], [%gone.next, %name]",
        "  %n.begun = getelementptr inbounds i64, ptr %begun, i64 %n",
        "  %n.more = load i64, ptr %n.begun, align 8",
        "  %n.real = icmp slt i64 %n, %count",
        "  %n.own = select i1 %n.real, i64 %n.more, i64 0",
        "  %gone.next = add i64 %gone, %n.own",
        "  %ancestor = call i64 @llvm.umin.i64(i64 %gone.next, i64 %last)",
        "  store i64 %ancestor, ptr %n.begun, align 8",
        "  %n.next = add i64 %n, 1",
        "  %named = icmp sge i64 %n.next, %N",
        "  br i1 %named, label %row, label %name",
        "row:",
        "  %r = phi i64 [0, %name], [%r.next, %row.end]",
        "  %r.start = mul i64 %r, %N",
        "  %from = getelementptr inbounds double, ptr %points, i64 %r.start",
        "  %to = getelementptr inbounds double, ptr %out, i64 %r.start",
        "  br label %take",
        "take:",
        "  %t = phi i64 [0, %row], [%t.next, %take]",
        "  %t.begun = getelementptr inbounds i64, ptr %begun, i64 %t",
        f"  %t.own = load <{WIDTH} x i64>, ptr %t.begun, align 8",
        f"  %t.from = getelementptr inbounds double, ptr %from, <{WIDTH} x i64> %t.own",
        (
            f"  %t.values = call {v} {gathered}({pointers} %t.from, i32 8, <{WIDTH} x i1> <{everywhere}>, "
            f"{v} poison)"
        ),
        "  %t.to = getelementptr inbounds double, ptr %to, i64 %t",
        f"  store {v} %t.values, ptr %t.to, align 8",
        f"  %t.next = add i64 %t, {WIDTH}",
        "  %taken = icmp sge i64 %t.next, %N",
        "  br i1 %taken, label %row.end, label %take",
        "row.end:",
        "  %r.next = add i64 %r, 1",
        "  %done = icmp sge i64 %r.next, %rows",
        "  br i1 %done, label %exit, label %row",
        "exit:",
        "  ret void",
        "}",
    ]
    return text + "\n".join(lines) + "\n"


# ----------------------------------------------------------------------------------- two stages
def twofold(first: str, second: str, n: int, m: int, count: int) -> str:
    """LLVM text of a pass that weighs in two stages, with a choice of ancestors between them.

    Its points are centres, the rows ``n``; a row for the likelihood at them; and what moves them, ``n``
    rows: then the rows of points take the place of centres. Scratch holds ``n + 5`` rows. ``count`` is
    the place of the number of particles in what it is given; the evidence of the first stage goes behind it.
    The first pass leaves a residual, its covariance, nis, evidence, sum of weights, and how much was
    measured; the second what passes leave of moments, evidence, and sum of weights.
    """
    v = f"<{WIDTH} x double>"
    parts = [
        text.replace("@step(", f"@{name}.step(")
        .replace("@last(", f"@{name}.last(")
        .replace("@weigh(", f"@{name}.weigh(")
        .replace("define void @run(", f"define internal void @{name}(")
        for name, text in (("first", first), ("second", second), ("choose", choosing()))
    ]
    text_lines = [line for text in parts for line in text.splitlines()]
    declared = dict.fromkeys(line for line in text_lines if line.startswith("declare "))
    defined = [line for line in text_lines if not line.startswith("declare ")]
    declared["declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)"] = None
    moments, told = n + n * n + 1, m + m * m + 1
    pointers = ", ".join(f"ptr %{name}" for name in _MATRICES)
    lines = [
        f"define void @run(i64 %N, i64 %k1, i64 %k2, i64 %word, {pointers}) {{",
        "entry:",
        f"  %one = alloca [{told + 3} x double], align 64",
        f"  %two = alloca [{moments + 2} x double], align 64",
        f"  %centres = mul i64 %N, {n + 1}",
        "  %moved = getelementptr inbounds double, ptr %points, i64 %centres",
        "  %scratch = getelementptr inbounds double, ptr %drawn, i64 %centres",
        (
            "  call void @first(i64 %N, i64 0, i64 0, i64 0, ptr %points, ptr %weights, ptr null, "
            "ptr %given, ptr %out, ptr %one)"
        ),
    ]

    def load(name: str, base: str, index: int) -> None:
        lines.append(f"  %{name}.at = getelementptr inbounds double, ptr %{base}, i64 {index}")
        lines.append(f"  %{name} = load double, ptr %{name}.at, align 8")

    load("evidence", "one", told)
    load("sum", "one", told + 1)
    load("measured", "one", told + 2)
    load("many", "given", count)
    lines += [
        f"  %evidence.to = getelementptr inbounds double, ptr %given, i64 {count + 1}",
        "  store double %evidence, ptr %evidence.to, align 8",
        "  %something = fcmp one double %measured, 0.0",
        "  br i1 %something, label %level, label %weigh",
        "level:",
        f"  %single = insertelement {v} poison, double %evidence, i32 0",
        f"  %all = shufflevector {v} %single, {v} poison, <{WIDTH} x i32> zeroinitializer",
        "  br label %less",
        "less:",
        "  %i = phi i64 [0, %level], [%i.next, %less]",
        "  %i.at = getelementptr inbounds double, ptr %out, i64 %i",
        f"  %i.now = load {v}, ptr %i.at, align 8",
        f"  %i.less = fsub {v} %i.now, %all",
        f"  store {v} %i.less, ptr %i.at, align 8",
        f"  %i.next = add i64 %i, {WIDTH}",
        "  %i.end = icmp sge i64 %i.next, %N",
        "  br i1 %i.end, label %choose, label %less",
        "choose:",
        "  %choices = fptosi double %many to i64",
        f"  %word.chosen = add i64 %word, {draws.FIRST_STAGE << 8}",
        (
            f"  call void @choose(i64 %choices, i64 %N, i64 {n + 1}, i64 %k1, i64 %k2, i64 %word.chosen, "
            "ptr %out, ptr %points, ptr %scratch, ptr %drawn)"
        ),
        "  br label %weigh",
        "weigh:",
        "  %from = phi ptr [%points, %entry], [%drawn, %choose]",
        "  %count = fptosi double %many to i64",
        "  %bytes = mul i64 %count, 8",  # what fills up is minus infinity there
        "  call void @llvm.memset.p0.i64(ptr %out, i8 0, i64 %bytes, i1 false)",
        (
            "  call void @second(i64 %N, i64 0, i64 0, i64 0, ptr %from, ptr %moved, ptr %out, "
            "ptr %given, ptr %points, ptr %two)"
        ),
        f"  call void @llvm.memcpy.p0.p0.i64(ptr %left, ptr %two, i64 {8 * moments}, i1 false)",
        f"  %left.told = getelementptr inbounds double, ptr %left, i64 {moments}",
        f"  call void @llvm.memcpy.p0.p0.i64(ptr %left.told, ptr %one, i64 {8 * told}, i1 false)",
    ]
    load("gained", "two", moments)
    load("sum.two", "two", moments + 1)
    lines += [
        "  %loglik = fadd double %evidence, %gained",
        "  %smaller = fcmp olt double %sum, %sum.two",
        "  %total = select i1 %smaller, double %sum, double %sum.two",
    ]
    for i, value in enumerate(("loglik", "total", "many")):
        lines.append(
            f"  %to.{value} = getelementptr inbounds double, ptr %left.told, i64 {told + i}"
        )
        lines.append(f"  store double %{value}, ptr %to.{value}, align 8")
    return "\n".join([*declared, *defined, *lines, "  ret void", "}"]) + "\n"


# -------------------------------------------------------------------------------------- steps
NUMBERS = {
    "first": "i64", "last": "i64", "count": "i64", "N": "i64", "n": "i64", "more": "i64",
    "k1": "i64", "k2": "i64", "step": "i64", "pace": "i64",
    "points": "ptr", "points.spare": "ptr", "points.chosen": "ptr",
    "weights": "ptr", "weights.spare": "ptr", "weights.even": "ptr", "scratch": "ptr",
    "ahead": "ptr", "ahead.given": "ptr", "ahead.inputs": "i64", "ahead.left": "ptr",
    "ahead.found": "i64", "sensors": "ptr", "which": "ptr", "measured": "ptr",
    "weigh.left": "ptr", "weigh.found": "i64", "choose": "ptr",
    "centre": "ptr", "apart": "i64", "size": "double", "enough": "double", "least": "double", "stopped": "i64",
}  # fmt: skip
"""What the loop over steps is given, each of 8 bytes, in this order; it writes back where it stopped.

``more`` are numbers that belong to a cloud as a whole, beside its rows: a pass leaves the mean, these, the
covariance, and 1 if digits were enough; and its row of numbers ends with a centre and these. ``pace`` is by how
much a step of the record moves the ``step`` that draws belong to.
"""

SENSOR = ("weigh", "given", "inputs", "found")
"""What it is given of each sensor: a pass, its rows of numbers, how long they are, and where among what is found
the log-likelihood comes, which the sum of weights and the effective sample size follow."""

DONE, UNUSUAL, DUE = range(3)
"""Why the loop stopped: at the end; before a step for the arrays; before a resampling for the arrays."""


@functools.cache
def stepping() -> str:
    """LLVM text of ``void run(numbers)``: steps of one cloud, each a prediction and a weighing.

    Rows ``first`` to ``last`` of a record. It stops early, with the cloud as it was before the step,
    where a pass says that digits were lost, where the sum of weights is not above ``least``, and where
    resampling is due and no pass for it is given.
    """
    v = f"<{WIDTH} x double>"
    lines = [
        "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)",
        *_COPIED,
        "define void @run(ptr %numbers) {",
        "entry:",
    ]
    for i, (name, kind) in enumerate(NUMBERS.items()):
        lines.append(f"  %at.{name} = getelementptr inbounds i64, ptr %numbers, i64 {i}")
        lines.append(f"  %{name} = load {kind}, ptr %at.{name}, align 8")

    def at(name: str, base: str, index: str, kind: str = "double") -> None:
        lines.append(f"  %{name} = getelementptr inbounds {kind}, ptr %{base}, i64 {index}")

    def load(name: str, base: str, index: str, kind: str = "double", unit: str = "double") -> None:
        at(f"{name}.at", base, index, unit)
        lines.append(f"  %{name} = load {kind}, ptr %{name}.at, align 8")

    lines += [
        "  %square = mul i64 %n, %n",
        "  %known = add i64 %n, %more",
        "  %moments = add i64 %known, %square",
        "  %all = sitofp i64 %count to double",
        "  br label %again",
        "again:",
        "  %k = phi i64 [%first, %entry], [%k.next, %next]",
        "  %p = phi ptr [%points, %entry], [%p.other, %next]",
        "  %p.other = phi ptr [%points.spare, %entry], [%p, %next]",
        "  %w = phi ptr [%weights, %entry], [%w.other, %next]",
        "  %w.other = phi ptr [%weights.spare, %entry], [%w, %next]",
        "  %worth = phi double [%size, %entry], [%worth.next, %next]",
        "  %mid = phi ptr [%centre, %entry], [%found, %next]",
        "  %mid.apart = phi i64 [%apart, %entry], [1, %next]",
        "  %since = sub i64 %k, %first",
        "  %gone = mul i64 %since, %pace",
        "  %now = add i64 %step, %gone",
        "  %word = shl i64 %now, 16",
        "  %end = icmp sge i64 %k, %last",
        "  br i1 %end, label %exit, label %begin",
        "begin:",
        "  %few = fcmp olt double %worth, %enough",
        "  br i1 %few, label %due, label %move",
        "due:",
        "  %here = icmp ne ptr %choose, null",
        "  br i1 %here, label %resample, label %exit",
        "resample:",
        f"  %word.chosen = add i64 %word, {draws.RESAMPLING << 8}",
        (
            "  call void %choose(i64 %count, i64 %N, i64 %n, i64 %k1, i64 %k2, i64 %word.chosen, ptr %w, "
            "ptr %p, ptr %scratch, ptr %points.chosen)"
        ),
        "  br label %move",
        "move:",
        "  %p.own = phi ptr [%p, %begin], [%points.chosen, %resample]",
        "  %w.own = phi ptr [%w, %begin], [%weights.even, %resample]",
        "  %worth.own = phi double [%worth, %begin], [%all, %resample]",
        "  %mid.own = phi ptr [%mid, %begin], [%points.chosen, %resample]",
        "  %apart.own = phi i64 [%mid.apart, %begin], [%N, %resample]",
    ]

    def given(row: str, inputs: str, pitch: str, source: str, apart: str) -> None:
        """The row of this step, ending with the centre and what belongs to the cloud as a whole."""
        lines.append(f"  %{row}.k = mul i64 %k, %{pitch}")
        at(row, inputs, f"%{row}.k")
        lines.append(f"  %{row}.rest = sub i64 %{pitch}, %known")
        at(f"{row}.centre", row, f"%{row}.rest")
        lines.append(f"  call void @copied(i64 %n, ptr %{source}, i64 {apart}, ptr %{row}.centre)")
        at(f"{row}.more.to", f"{row}.centre", "%n")
        at(f"{row}.more.from", "mid" if row == "row" else source, "%n")
        lines.append(
            f"  call void @copied(i64 %more, ptr %{row}.more.from, i64 1, ptr %{row}.more.to)"
        )

    given("row", "ahead.given", "ahead.inputs", "mid.own", "%apart.own")
    lines.append("  %ahead.k = mul i64 %k, %ahead.found")
    at("going", "ahead.left", "%ahead.k")
    lines += [
        f"  %word.noise = add i64 %word, {draws.NOISE << 8}",
        (
            "  call void %ahead(i64 %N, i64 %k1, i64 %k2, i64 %word.noise, ptr %p.own, ptr %w.own, "
            "ptr %scratch, ptr %row, ptr %p.other, ptr %going)"
        ),
    ]
    load("fine", "going", "%moments")
    lines += [
        "  %usual = fcmp one double %fine, 0.0",
        "  br i1 %usual, label %look, label %exit",
        "look:",
    ]
    load("which.k", "which", "%k", "i64", "i64")
    lines.append(f"  %sensor.k = mul i64 %which.k, {len(SENSOR)}")
    at("sensor", "sensors", "%sensor.k", "i64")
    for i, (name, kind) in enumerate(zip(SENSOR, ("ptr", "ptr", "i64", "i64"), strict=True)):
        load(f"sensor.{name}", "sensor", str(i), kind, "i64")
    given("seen", "sensor.given", "sensor.inputs", "going", "1")
    lines.append("  %weigh.k = mul i64 %k, %weigh.found")
    at("found", "weigh.left", "%weigh.k")
    lines += [
        f"  %word.weigh = add i64 %word, {draws.word(1, 0)}",
        (
            "  call void %sensor.weigh(i64 %N, i64 %k1, i64 %k2, i64 %word.weigh, ptr %p.other, "
            "ptr %w.own, ptr %scratch, ptr %seen, ptr %w.other, ptr %found)"
        ),
    ]
    load("measured.k", "measured", "%k", "i64", "i64")
    at("loglik.at", "found", "%sensor.found")
    lines += [
        "  %told = icmp ne i64 %measured.k, 0",
        "  br i1 %told, label %told.something, label %told.nothing",
        "told.something:",
        "  %loglik = load double, ptr %loglik.at, align 8",
    ]
    load("total", "loglik.at", "1")
    load("worth.found", "loglik.at", "2")
    load("sharp", "found", "%moments")
    lines += [
        "  %enough.left = fcmp ogt double %total, %least",
        "  %sharp.enough = fcmp one double %sharp, 0.0",
        "  %good = and i1 %enough.left, %sharp.enough",
        "  br i1 %good, label %level, label %exit",
        "level:",
        f"  %one = insertelement {v} poison, double %loglik, i32 0",
        f"  %everywhere = shufflevector {v} %one, {v} poison, <{WIDTH} x i32> zeroinitializer",
        "  br label %less",
        "less:",
        "  %i = phi i64 [0, %level], [%i.next, %less]",
        "  %i.at = getelementptr inbounds double, ptr %w.other, i64 %i",
        f"  %i.now = load {v}, ptr %i.at, align 8",
        f"  %i.less = fsub {v} %i.now, %everywhere",
        f"  store {v} %i.less, ptr %i.at, align 8",
        f"  %i.next = add i64 %i, {WIDTH}",
        "  %i.end = icmp sge i64 %i.next, %N",
        "  br i1 %i.end, label %next, label %less",
        "told.nothing:",  # not even rounding changes weights without evidence
        "  %bytes = mul i64 %N, 8",
        "  call void @llvm.memcpy.p0.p0.i64(ptr %w.other, ptr %w.own, i64 %bytes, i1 false)",
        "  %bytes.moments = mul i64 %moments, 8",
        "  call void @llvm.memcpy.p0.p0.i64(ptr %found, ptr %going, i64 %bytes.moments, i1 false)",
        "  store double 0.0, ptr %loglik.at, align 8",
        "  br label %next",
        "next:",
        "  %worth.next = phi double [%worth.found, %less], [%worth.own, %told.nothing]",
        "  %k.next = add i64 %k, 1",
        "  br label %again",
        "exit:",
        (
            f"  %why = phi i64 [{DONE}, %again], [{DUE}, %due], [{UNUSUAL}, %move], "
            f"[{UNUSUAL}, %told.something]"
        ),
    ]
    left = {
        "first": "i64 %k", "step": "i64 %now", "points": "ptr %p", "points.spare": "ptr %p.other",
        "weights": "ptr %w", "weights.spare": "ptr %w.other", "centre": "ptr %mid",
        "apart": "i64 %mid.apart", "size": "double %worth", "stopped": "i64 %why",
    }  # fmt: skip
    lines += [f"  store {value}, ptr %at.{name}, align 8" for name, value in left.items()]
    return "\n".join([*lines, "  ret void", "}"]) + "\n"


_COPIED = (
    "define internal void @copied(i64 %n, ptr %from, i64 %apart, ptr %to) {",
    "entry:",
    "  br label %again",
    "again:",
    "  %i = phi i64 [0, %entry], [%i.next, %one]",
    "  %done = icmp sge i64 %i, %n",
    "  br i1 %done, label %exit, label %one",
    "one:",
    "  %place = mul i64 %i, %apart",
    "  %source = getelementptr inbounds double, ptr %from, i64 %place",
    "  %value = load double, ptr %source, align 8",
    "  %target = getelementptr inbounds double, ptr %to, i64 %i",
    "  store double %value, ptr %target, align 8",
    "  %i.next = add i64 %i, 1",
    "  br label %again",
    "exit:",
    "  ret void",
    "}",
)
