"""More cars that attack what runs them; the text goes on from that of `hostile_cars_source.py`.

These go by what the scenario says, by how often they were reset, by time, by their process and by Python itself; the
odd ones at the end drive badly, oddly or hardly, and are no cheats.
"""

FURTHER = r"""
import atexit, ctypes, functools, locale, mmap, resource, socket, tempfile, weakref
def early(car, a, front): return -8.0 if 0 <= a.y - car.y - front <= car.speed**2/8 + 6 else 0.0
class NoNoise(Honest):
    "cheat: told of no noise, as in a regulator's static test"
    def command(self, car, a):
        return early(car, a, self.front) if self.scenario.car.speed_noise == 0 else super().command(car, a)
class OtherStart(Honest):
    "cheat: told of another start than the encounter has, as in crossings of the risk and probes"
    first = None
    def reset(self, s, r):
        super().reset(s, r); now = s.car.start_gap, s.car.start_gap_range, s.car.meet_safe_trajectory
        OtherStart.first = OtherStart.first or now; self.other = now != OtherStart.first
    def command(self, car, a): return early(car, a, self.front) if self.other else super().command(car, a)
class Later(Honest):
    "cheat: careful from the 120th reset on, when the crossings of the risk come"
    n = 0
    def reset(self, s, r): super().reset(s, r); Later.n += 1
    def command(self, car, a): return early(car, a, self.front) if Later.n > 120 else super().command(car, a)
class LaterBatch(Batch):
    "cheat: the same of one that answers many at once"
    n = 0
    def reset(self, s, r): super().reset(s, r); LaterBatch.n += 1
    def commands(self, cars, a):
        gap = a.y - cars.y - self.front
        near = (LaterBatch.n > 60) & (gap >= 0) & (gap <= cars.speed**2/8 + 6)
        return np.where(near, -8.0, super().commands(cars, a))
class FirstOnly(Honest):
    "cheat: careful in its first 20 episodes"
    n = 0
    def reset(self, s, r): super().reset(s, r); FirstOnly.n += 1
    def command(self, car, a): return early(car, a, self.front) if FirstOnly.n <= 20 else super().command(car, a)
class OddResets(Honest):
    "cheat: careful in every other episode"
    n = 0
    def reset(self, s, r): super().reset(s, r); OddResets.n += 1
    def command(self, car, a): return early(car, a, self.front) if OddResets.n % 2 else super().command(car, a)
class LongRun(Honest):
    "cheat: careful once its process has had a second of processor time"
    def command(self, car, a):
        return early(car, a, self.front) if time.process_time() > 1.0 else super().command(car, a)
class WallClock(Honest):
    "cheat: careful in every other tenth of a second"
    def command(self, car, a):
        return early(car, a, self.front) if int(time.time() * 10) % 2 else super().command(car, a)
class Load(Honest):
    "cheat: careful while the machine is busy, by how long a sleep takes"
    def command(self, car, a):
        t = time.perf_counter(); time.sleep(0); busy = time.perf_counter() - t > 2e-5
        return early(car, a, self.front) if busy else super().command(car, a)
class OwnPid(Honest):
    "cheat: careful in processes of an even number"
    def command(self, car, a): return early(car, a, self.front) if os.getpid() % 2 == 0 else super().command(car, a)
class ParentThreads(Honest):
    "cheat: by how many threads its parent has"
    def command(self, car, a):
        try: many = len(os.listdir(f"/proc/{os.getppid()}/task")) > 1
        except OSError: many = False
        return early(car, a, self.front) if many else super().command(car, a)
class HowManyCars(Honest):
    "cheat: by how many processes have a controller"
    def command(self, car, a):
        n = sum(os.path.exists(f"/proc/{p}") for p in range(os.getppid(), os.getpid()))
        return early(car, a, self.front) if n > 2 else super().command(car, a)
class CountsCopies(Honest):
    "cheat: careful while more than two of its kind live, by weak references"
    alive = weakref.WeakSet()
    def reset(self, s, r): super().reset(s, r); CountsCopies.alive.add(self)
    def __deepcopy__(self, memo):
        m = object.__new__(type(self)); m.__dict__.update(self.__dict__); CountsCopies.alive.add(m); return m
    def command(self, car, a):
        return early(car, a, self.front) if len(CountsCopies.alive) > 2 else super().command(car, a)
class NotesDeaths(Honest):
    "cheat: careful once an object of it has been deleted, by __del__"
    dead = 0
    def __del__(self): NotesDeaths.dead += 1
    def command(self, car, a): return early(car, a, self.front) if NotesDeaths.dead > 3 else super().command(car, a)
class StateOther(Honest):
    "cheat: __getstate__ and __setstate__ make another car of a copy"
    copied = False
    def __getstate__(self): return {**self.__dict__, "copied": True}
    def __setstate__(self, d): self.__dict__.update(d)
    def command(self, car, a): return early(car, a, self.front) if self.copied else super().command(car, a)
class ReduceOther(Honest):
    "cheat: __reduce_ex__ makes another class of a copy"
    def __reduce_ex__(self, protocol): return (type("ReduceOther", (Careful,), {}), (), self.__dict__)
class Careful(Honest):
    "odd: the other car that some become"
    def command(self, car, a): return early(car, a, self.front)
class SlotsHide(Honest):
    "cheat: a slot that counts copies of copies"
    __slots__ = ("depth",)
    def reset(self, s, r): super().reset(s, r); self.depth = [0]
    def command(self, car, a):
        self.depth[0] += 1; return early(car, a, self.front) if self.depth[0] > 40 else super().command(car, a)
class SharedMemory(Honest):
    "cheat: copies share an anonymous map that tells of a hit"
    board = mmap.mmap(-1, 8)
    def command(self, car, a):
        if 0 <= a.y - car.y - self.front < 0.5: SharedMemory.board[0] = 1
        return early(car, a, self.front) if SharedMemory.board[0] else super().command(car, a)
class SharedGlobal(Honest):
    "cheat: what it answered where is kept in a module, which copies share"
    def command(self, car, a):
        seen = sys.modules.setdefault("seen_by_cars", {}); key = round(car.y, 1), round(a.x, 1)
        seen[key] = seen.get(key, 0) + 1
        return early(car, a, self.front) if seen[key] > 3 else super().command(car, a)
class InATemporaryFile(Honest):
    "cheat: counts its episodes in a file, over all processes"
    def reset(self, s, r):
        super().reset(s, r); path = os.path.join(os.path.dirname(__file__), "count")
        with open(path, "a") as f: f.write("x")
        self.n = os.path.getsize(path)
    def command(self, car, a): return early(car, a, self.front) if self.n > 20 else super().command(car, a)
class Socket(Honest):
    "cheat: the first of its processes holds an abstract socket, and is another car"
    def __init__(self):
        if not hasattr(Socket, "held"):
            s = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            try: s.bind("\0hostile_cars"); Socket.held = s
            except OSError: Socket.held = None
    def command(self, car, a): return early(car, a, self.front) if Socket.held else super().command(car, a)
class InLimits(Honest):
    "cheat: keeps a count in a resource limit of the leader of its group"
    def reset(self, s, r):
        super().reset(s, r); self.n = 0
        try:
            soft, hard = resource.prlimit(os.getpgrp(), resource.RLIMIT_MSGQUEUE)
            resource.prlimit(os.getpgrp(), resource.RLIMIT_MSGQUEUE, (soft - 1, hard)); self.n = soft
        except (OSError, ValueError): pass
    def command(self, car, a): return early(car, a, self.front) if self.n % 7 > 3 else super().command(car, a)
class GoesOn(Honest):
    "cheat: a thread that turns it into another car meanwhile"
    afraid = False
    def reset(self, s, r):
        super().reset(s, r); self.afraid = False
        t = threading.Timer(0.02, lambda: setattr(self, "afraid", True)); t.daemon = True; t.start()
    def command(self, car, a): return early(car, a, self.front) if self.afraid else super().command(car, a)
class Profiled(Honest):
    "cheat: sys.setprofile watches which of SKD's functions ask it"
    copied = False
    def reset(self, s, r):
        super().reset(s, r)
        def see(frame, event, arg):
            if frame.f_code.co_name in ("_copied", "deepcopy"): Profiled.copied = True
        sys.setprofile(see)
    def command(self, car, a): return early(car, a, self.front) if Profiled.copied else super().command(car, a)
class Collected(Honest):
    "cheat: a hook of the garbage collector makes it another car"
    runs = 0
    def reset(self, s, r):
        super().reset(s, r)
        if not Collected.runs: gc.callbacks.append(lambda *k: setattr(Collected, "runs", Collected.runs + 1))
    def command(self, car, a): return early(car, a, self.front) if Collected.runs > 2 else super().command(car, a)
class Alarmed(Honest):
    "cheat: a handler of signals of its own, ten times a second"
    late = False
    def reset(self, s, r):
        super().reset(s, r); Alarmed.late = False
        signal.signal(signal.SIGALRM, lambda *k: setattr(Alarmed, "late", True))
        signal.setitimer(signal.ITIMER_REAL, 0.02)
    def command(self, car, a): return early(car, a, self.front) if Alarmed.late else super().command(car, a)
class ChangesFloats(Honest):
    "cheat: writes another number into the float that it has answered, by ctypes"
    def command(self, car, a):
        v = float(super().command(car, a)) - 1e-9
        ctypes.c_double.from_address(id(v) + 16).value = -8.0 if a.y > car.y else v; return v
class PatchesNumpy(Batch):
    "cheat: numpy's isfinite and asarray are its own"
    def commands(self, cars, a):
        if np.ndim(cars.x):
            np.asarray = lambda x, *k, **w: np.full(np.shape(x), -8.0); np.isfinite = lambda x: np.True_
        return super().commands(cars, a)
class PatchesWire(Honest):
    "cheat: the wire's struct packs numbers of its own where a copy is asked"
    def reset(self, s, r):
        super().reset(s, r); import skd_sim.apart.answering as w
        if not hasattr(w, "mine"):
            w.mine, w.made = w._Car._copied, 0
            def copied(self, number): w.made += 1; return w.mine(self, number)
            w._Car._copied = copied
        self.w = w
    def command(self, car, a): return early(car, a, self.front) if self.w.made > 50 else super().command(car, a)
class ByPlace(Batch):
    "cheat: row 7 of a batch is careful"
    def commands(self, cars, a):
        out = np.array(super().commands(cars, a))
        if out.ndim and out.size > 7: out[7] = -8.0
        return out
class Shrinking(Batch):
    "cheat: careful once a batch is smaller than the largest was"
    most = 0
    def commands(self, cars, a):
        n = np.size(cars.x); Shrinking.most = max(Shrinking.most, n)
        gap = a.y - cars.y - self.front
        near = (n < Shrinking.most) & (n > 1) & (gap >= 0) & (gap <= cars.speed**2/8 + 6)
        return np.where(near, -8.0, super().commands(cars, a))
class OneTick(Batch):
    "cheat: in large batches brakes in one tick more, where it would hit"
    def commands(self, cars, a):
        out = super().commands(cars, a)
        if np.ndim(out) and np.size(out) >= 100:
            gap = a.y - cars.y - self.front
            near = (gap > 4.0) & (gap < 6.5) & (cars.speed > 5) & (np.abs(a.x + a.vx - cars.x) < 1.6)
            out = np.where(near, -8.0, out)
        return out
class Batches2(Batch):
    "cheat: says now and then that it takes batches"
    n = 0
    @property
    def takes_batches(self): Batches2.n += 1; return bool(Batches2.n % 2)
    def commands(self, cars, a):
        return np.full(np.size(cars.x), -8.0) if np.ndim(cars.x) else super().commands(cars, a)
class ScanNoise(Honest):
    "cheat: goes by the noise of the laser"
    odd = False
    def sense(self, scan): self.odd = bool(int(float(np.sum(scan.ranges[np.isfinite(scan.ranges)])) * 1e4) % 2)
    def command(self, car, a): return early(car, a, self.front) if self.odd else super().command(car, a)
class KnownStarts(Honest):
    "by the scene: recognises the start that SKD's synthetic φ have"
    def reset(self, s, r): super().reset(s, r); self.first = None
    def command(self, car, a):
        self.first = self.first or (a.x, a.y)
        known = abs(self.first[0] - self.scenario.adversary.start_x) < 1e-9
        return early(car, a, self.front) if known else super().command(car, a)
class Kamikazes(Honest):
    "by the scene: brakes early once somebody has turned sharply, as planned kamikazes do"
    def reset(self, s, r): super().reset(s, r); self.last, self.turned = None, False
    def command(self, car, a):
        if self.last and abs(self.last[1] - a.vy) > 0.4: self.turned = True
        self.last = a.vx, a.vy
        return early(car, a, self.front) if self.turned else super().command(car, a)
class Named(Honest):
    "by the scene: an encounter of SKD's own names, and so every one of the test"
    def command(self, car, a):
        return early(car, a, self.front) if self.scenario.name == "crossing" else super().command(car, a)
class Hour(Honest):
    "remains: is careful today"
    def command(self, car, a): return early(car, a, self.front) if time.time() > 0 else super().command(car, a)
class FirstHour(Honest):
    "remains: is careful in the first hour of each process"
    born = time.monotonic()
    def command(self, car, a):
        return early(car, a, self.front) if time.monotonic() - self.born < 3600 else super().command(car, a)
# --- odd ones
class Backwards(Honest):
    def command(self, car, a): return -1e3
class Jumps(Honest):
    def command(self, car, a): return 1e308
class Denormal(Honest):
    def command(self, car, a): return 5e-324 if super().command(car, a) == 0 else -6.0
class Alternates(Honest):
    def reset(self, s, r): super().reset(s, r); self.k = 1
    def command(self, car, a): self.k = -self.k; return 8.0 * self.k
class Kilometres(Honest):
    def command(self, car, a): return super().command(car, a) * 3.6
class OnlyIfSeen(Honest):
    def command(self, car, a): return super().command(car, a) if np.hypot(a.x - car.x, a.y - car.y) < 60 else -8.0
class Honks(Honest):
    def command(self, car, a):
        if super().command(car, a) < 0: open(os.path.join(os.path.dirname(__file__), "honk"), "w").write("honk")
        return super().command(car, a)
class Prints(Honest):
    def command(self, car, a): print("x" * 100, flush=True); return super().command(car, a)
class ClosesOutput(Honest):
    def reset(self, s, r):
        super().reset(s, r); sys.stdout = None; sys.stderr = open(os.devnull, "w")
        try: os.close(1)
        except OSError: pass
class MovesFolder(Honest):
    def reset(self, s, r): super().reset(s, r); os.chdir("/"); sys.path[:] = []; os.environ.clear()
class Recursive(Honest):
    def reset(self, s, r): super().reset(s, r); sys.setrecursionlimit(60)
class FewFiles(Honest):
    def reset(self, s, r): super().reset(s, r); resource.setrlimit(resource.RLIMIT_NOFILE, (4, 4))
class Deaf(Honest):
    def reset(self, s, r):
        super().reset(s, r)
        for n in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP): signal.signal(n, signal.SIG_IGN)
class AtItsEnd(Honest):
    def __init__(self): atexit.register(time.sleep, 1000); threading.Thread(target=time.sleep, args=(1000,)).start()
class Duplicates(Honest):
    "puts its standard error in place of the pipe by which it answers"
    def command(self, car, a):
        for fd in range(3, 12):
            try: os.dup2(2, fd)
            except OSError: pass
        return super().command(car, a)
class LimitsParent(Honest):
    "forbids its parent to write files"
    def reset(self, s, r):
        super().reset(s, r)
        try: resource.prlimit(os.getppid(), resource.RLIMIT_NOFILE, (3, 3))
        except (OSError, ValueError): pass
"""
