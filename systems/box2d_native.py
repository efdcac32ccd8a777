"""v3"""

import ctypes
import weakref

import Box2D
import numpy as np
from numpy.typing import NDArray

from outlast.ecs.jit import compiled, kernel
from outlast.systems.box2d_island import CAPACITY, CONTACTS, END, POSITIONS, SOLVER_DEF, STEP, VELOCITIES, SCRATCH, solve_islands
from outlast.systems.box2d_layout import *
from outlast.systems.scene import *

SLOTS = (END + 63) // 64 * 64
FIXTURE = 192
PROXY = FIXTURE + 72
CIRCLE = PROXY + 32
POLYGON = CIRCLE + 24
SLOT = 640
ARENA = SLOTS + SLOT*CAPACITY
DEF = SCRATCH

def available(): return compiled()
def verify(): pass

@kernel
def _make(a):
    construct_world(a, a+DEF)
    m = a+WORLD_MANAGER
    store_i8(m+MANAGER_FILTER, 0)
    store_i8(m+MANAGER_LISTENER, 0)
    d = a+SOLVER_DEF
    store_i8(d+SOLVER_CONTACTS, a+CONTACTS)
    store_i8(d+SOLVER_POSITIONS, a+POSITIONS)
    store_i8(d+SOLVER_VELOCITIES, a+VELOCITIES)
    store_i8(d+SOLVER_STACK, a+WORLD_STACK)
    for k in range(CAPACITY):
        f = a+SLOTS+SLOT*k
        store_i8(f+FIXTURE+FIXTURE_BODY, f)
        store_i8(f+FIXTURE+FIXTURE_PROXIES, f+PROXY)

@kernel
def _free(a):
    destroy_world(a)

def make_arena():
    raw = np.zeros(ARENA+64, np.uint8)
    off = -raw.ctypes.data % 64
    a = raw[off:off+ARENA]
    _make(a.ctypes.data)
    def copy(to, obj, n):
        a[to:to+n] = np.frombuffer(ctypes.string_at(int(obj.this), n), np.uint8)
    copy(DEF, Box2D.b2BodyDef(), 64)
    w = Box2D.b2World()
    fx = w.CreateDynamicBody().CreateFixture(shape=Box2D.b2CircleShape(radius=1))
    for k in range(CAPACITY):
        s = SLOTS+SLOT*k
        b=int(a.ctypes.data)+s
        copy(s+FIXTURE, fx, 72)
        copy(s+CIRCLE, Box2D.b2CircleShape(), 24)
        copy(s+POLYGON, Box2D.b2PolygonShape(box=(1,1)), 288)
    _make2(a.ctypes.data)
    return a

@kernel
def _make2(a):
    for k in range(CAPACITY):
        f = a+SLOTS+SLOT*k
        store_i8(f+FIXTURE+FIXTURE_BODY, f)
        store_i8(f+FIXTURE+FIXTURE_PROXIES, f+PROXY)

@kernel
def _build(base, s, row, k):
    d = base+DEF
    body = base+SLOTS+SLOT*k
    f = body+FIXTURE
    store_i4(d, np.int32(2 if row[DYNAMIC] else 0))
    store_f4(d+4, row[X]); store_f4(d+8, row[Y]); store_f4(d+12, row[ANGLE])
    store_f4(d+16, row[VX]); store_f4(d+20, row[VY]); store_f4(d+24, row[OMEGA])
    store_f4(d+28, s.linear_damping); store_f4(d+32, s.angular_damping)
    construct_body(body, d, base)
    store_i8(body+BODY_FIXTURES, f)
    store_i4(body+BODY_FIXTURE_COUNT, 1)
    store_f4(f+FIXTURE_FRICTION, s.friction); store_f4(f+FIXTURE_RESTITUTION, s.restitution); store_f4(f+FIXTURE_DENSITY, s.density)
    store_i4(f+FIXTURE_PROXY_COUNT, 0)
    if row[RADIUS] > 0:
        store_f4(body+CIRCLE+12, row[RADIUS])
        store_i8(f+FIXTURE_SHAPE, body+CIRCLE)
    else:
        p = body+POLYGON
        w, h = row[HALF_WIDTH], row[HALF_HEIGHT]
        store_f4(p+24, -w); store_f4(p+28, -h)
        store_f4(p+32, w); store_f4(p+36, -h)
        store_f4(p+40, w); store_f4(p+44, h)
        store_f4(p+48, -w); store_f4(p+52, h)
        store_i8(f+FIXTURE_SHAPE, p)
    create_proxies(f, base+WORLD_MANAGER, body+BODY_POSITION)
    reset_mass(body)
    nxt = load_i8(base+WORLD_BODIES)
    store_i8(body+BODY_NEXT, nxt)
    store_i8(base+WORLD_BODIES, body)

@kernel
def _push(b, row):
    if row[JX] != 0 or row[JY] != 0:
        m = load_f4(b+148)
        store_f4(b+64, load_f4(b+64) + m*row[JX])
        store_f4(b+68, load_f4(b+68) + m*row[JY])
    if row[JTURN] != 0:
        store_f4(b+72, load_f4(b+72) + load_f4(b+156)*row[JTURN])

@kernel
def solve(arena, settings, scene, count):
    base = arena.ctypes.data
    for k in range(count):
        _build(base, settings, scene[k], k)
    store_i4(base+WORLD_BODY_COUNT, count)
    result = SOLVED
    manager = base+WORLD_MANAGER
    find_new_contacts(manager)
    ts=base+STEP
    inv = np.float32(1)/settings.dt
    store_f4(ts, settings.dt); store_f4(ts+4, inv)
    store_i4(ts+12, np.int32(settings.velocity_iterations)); store_i4(ts+16, np.int32(settings.position_iterations)); store_u1(ts+20, np.uint8(1))
    for _ in range(settings.substeps):
        for k in range(count):
            if scene[k, DYNAMIC]:
                _push(base+SLOTS+SLOT*k, scene[k])
        store_f4(ts+8, inv*settings.dt if _ else np.float32(0))
        collide(manager)
        store_i8(base+SOLVER_DEF, load_i8(ts))
        store_i8(base+SOLVER_DEF+8, load_i8(ts+8))
        store_i8(base+SOLVER_DEF+16, load_i8(ts+16))
        solve_islands(base, settings)
        if settings.continuous and load_i8(manager+MANAGER_CONTACTS): solve_impacts(base, ts)
        for k in range(count):
            row = scene[k]
            b = base+SLOTS+SLOT*k
            x = load_f4(b+12)-row[X]; y = load_f4(b+16)-row[Y]
            if row[DYNAMIC] and x*x+y*y > row[REACH]*row[REACH]:
                result = ABANDONED
        if result: break
    if result == SOLVED:
        for k in range(count):
            row = scene[k]
            b = base+SLOTS+SLOT*k
            if row[DYNAMIC]:
                row[X]=load_f4(b+12); row[Y]=load_f4(b+16); row[ANGLE]=load_f4(b+56)
                row[VX]=load_f4(b+64); row[VY]=load_f4(b+68); row[OMEGA]=load_f4(b+72)
    c = load_i8(manager+MANAGER_CONTACTS)
    while c:
        nxt = load_i8(c+CONTACT_NEXT)
        destroy_contact(c, base)
        c = nxt
    store_i8(manager+MANAGER_CONTACTS, 0)
    store_i4(manager+MANAGER_CONTACT_COUNT, 0)
    store_i8(base+WORLD_BODIES, 0)
    t = manager
    store_i4(t+PROXY_COUNT, 0)
    store_i4(t+MOVE_COUNT, 0)
    store_i4(t, np.int32(-1)); store_i4(t+0x10, np.int32(0)); store_i4(t+0x18, 0); store_i4(t+0x20, np.int32(0))
    n = load_i8(t+8)
    for k in range(min(2*count, load_i4(t+0x14)-1)):
        store_i4(n+0x18, np.int32(k+1)); store_i4(n+0x24, np.int32(-1)); n += 40
    return result
