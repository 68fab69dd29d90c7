"""What the fields of a simulation occupy, counted from the fields themselves."""

from __future__ import annotations

import math
from typing import Any

from taichi_dem.engine import Engine
from taichi_dem.extrapolation import course_members
from taichi_dem.grid import CELLS, Grid
from taichi_dem.types import ti


def memory(engine: Engine) -> dict[str, int]:
    """Bytes by part, as they are now; the contact list may grow later."""
    grid = engine.grid
    parts = {
        "particles": fields(engine.particles),
        "contact list": fields(engine.contacts),
        "cells": fields(grid) if grid.dense else sparse(grid),
        "boundaries": fields(engine.boundaries),
    }
    if engine.exchange is not None:
        parts["substrate"] = _substrate(engine.exchange)
    if engine.expansions is not None:
        parts["multi-contact"] = fields(engine.expansions)
    if engine.sleep is not None:
        parts["sleep"] = fields(engine.sleep)
    return parts


def by_effect(engine: Engine) -> dict[str, int]:
    """Bytes that are there because an effect is on, by its name in ``engine.effects``."""
    contacts, exchange, walls = engine.contacts, engine.exchange, engine.boundaries
    held = [contacts, exchange] if exchange is not None else [contacts]
    parts = {
        "rotation": sum(member(contacts.result, name) for name in ("couple", "torque")),
        "history": sum(part(one, "history") + part(one, "old_history") for one in held),
        "dissipation": part(contacts, "lost")
        + (part(contacts, "old_result") if contacts.dissipates else 0)
        + member(contacts.result, "drag"),
    }
    if exchange is not None:
        parts["adhesion"] = part(exchange, "held")
        courses = _courses(exchange)
        parts["extrapolated exchange"] = courses
        parts["substrate coupling"] = _substrate(exchange) - courses
    if engine.expansions is not None:
        parts["multi-contact"] = fields(engine.expansions)
    if engine.sleep is not None:
        kept = 0 if contacts.dissipates else part(contacts, "old_result")
        parts["sleep"] = fields(engine.sleep) + kept
    if walls.any_moves:
        parts["moving boundaries"] = size(walls.pressing) + size(walls.table)
    return parts


def fields(owner: Any) -> int:
    """Bytes of the fields that are attributes of ``owner``."""
    return sum(size(value) for value in vars(owner).values() if isinstance(value, ti.Field))


def part(owner: Any, name: str) -> int:
    """Bytes of one field of ``owner``, which may be absent."""
    return size(getattr(owner, name)) if hasattr(owner, name) else 0


def member(struct: Any, name: str) -> int:
    """Bytes of one member of a field of structs, which may be absent."""
    return size(struct.get_member_field(name)) if name in struct.keys else 0


def _substrate(exchange: Any) -> int:
    parts = [exchange, exchange.doubts, exchange.solver, exchange.solver.sums]
    if exchange.extrapolates:
        parts.append(exchange.between)
    return sum(fields(one) for one in parts)


def _courses(exchange: Any) -> int:
    """What is kept to extrapolate from."""
    if not exchange.extrapolates:
        return 0
    held = 2 * sum(member(exchange.ground, name) for name in course_members())
    return fields(exchange.between) + held


def size(field: Any) -> int:
    """Bytes of one field: scalar, vector or struct."""
    if hasattr(field, "keys"):
        return sum(size(field.get_member_field(name)) for name in field.keys)
    components = getattr(field, "n", 1) * getattr(field, "m", 1)
    return math.prod(field.shape) * components * int(str(field.dtype)[1:]) // 8


def sparse(grid: Grid) -> int:
    """Bytes of a grid whose blocks exist only where they are occupied."""
    whole = size(grid.block_population) + size(grid.population) + size(grid.end)
    pointers = 8 * math.prod(grid.block_population.shape)
    block = size(grid.block_population) // math.prod(grid.block_population.shape)
    block += CELLS * (size(grid.population) + size(grid.end)) // math.prod(grid.end.shape)
    return fields(grid) - whole + pointers + int(grid.occupied_count[0]) * block
