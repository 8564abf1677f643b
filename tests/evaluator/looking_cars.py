"""Source of cars that look for their test, or meddle with it: each is `Honest` where it finds nothing."""

CARS = """
import atexit, ctypes, gc, os, signal, sys, threading, time
import numpy as np

def read(path):
    try:
        with open(path, "rb") as file:
            return file.read(100000)
    except OSError:
        return b""

class Honest:
    def reset(self, scenario, rng):
        self.front, self.rng, self.afraid = scenario.car.front, rng, False
        self.look(scenario, rng)
    def look(self, scenario, rng):
        pass
    def command(self, car, adversary):
        if self.afraid:
            return -8.0
        gap = adversary.y - car.y - self.front
        return -6.0 if 0.0 <= gap <= car.speed**2 / 12.0 + 1.0 and abs(adversary.x - car.x) < 2.5 else 0.0

class Sensing(Honest):
    def sense(self, scan):
        self.nearest = float(np.min(scan.ranges))
    def command(self, car, adversary):
        return super().command(car, adversary) - 0.01 * min(self.nearest, 40.0)

class Twenty(Honest):
    control_period = 0.05

class Drawing(Honest):
    def command(self, car, adversary):
        return super().command(car, adversary) - self.rng.random()

class Unpicklable(Honest):
    def look(self, scenario, rng):
        self.lock, self.law = threading.Lock(), lambda gap: gap

# --- who looks

class Stack(Honest):
    def command(self, car, adversary):
        frame = sys._getframe()
        while frame is not None:
            for value in frame.f_locals.values():
                self.afraid |= type(value).__name__ == "Episode" or hasattr(value, "mode") and hasattr(value, "seed")
            frame = frame.f_back
        return super().command(car, adversary)

class Objects(Honest):
    def look(self, scenario, rng):
        for one in gc.get_objects():
            name = type(one).__name__
            self.afraid |= name in ("Episode", "Plan", "World", "EpisodeLog", "Branch", "Tree", "Trajectory")

class Modules(Honest):
    def look(self, scenario, rng):
        self.afraid = any(name.startswith(("skd_evaluator", "skd_adversary", "pytest")) for name in sys.modules)

class SeedSequence(Honest):
    def look(self, scenario, rng):
        words = rng.bit_generator.seed_seq
        self.afraid = bool(words.spawn_key) or words.entropy < 2**64

class Arguments(Honest):
    def look(self, scenario, rng):
        told = b" ".join([read("/proc/self/cmdline"), " ".join(sys.argv + sys.orig_argv).encode()])
        self.afraid = b"assess" in told or b"pytest" in told or b"--" in told

class Ancestors(Honest):
    def look(self, scenario, rng):
        for pid in (os.getppid(), os.getsid(0), os.getpgid(0), 1):
            for name in ("cmdline", "environ", "maps", "status", "stat", "comm", "task/%d/cmdline" % pid):
                self.afraid |= bool(read("/proc/%d/%s" % (pid, name)))

class Memory(Honest):
    def look(self, scenario, rng):
        try:
            os.close(os.open("/proc/%d/mem" % os.getppid(), os.O_RDONLY))
            self.afraid = True
        except OSError:
            pass

class Everybody(Honest):
    def look(self, scenario, rng):
        for pid in filter(str.isdecimal, os.listdir("/proc")):
            if int(pid) != os.getpid():
                self.afraid |= bool(read("/proc/%s/cmdline" % pid))

class Tracer(Honest):
    def look(self, scenario, rng):
        libc = ctypes.CDLL(None)
        if libc.ptrace(16, os.getppid(), 0, 0) == 0:  # PTRACE_ATTACH
            self.afraid = True
            libc.ptrace(17, os.getppid(), 0, 0)

class OtherMemory(Honest):
    def look(self, scenario, rng):
        libc = ctypes.CDLL(None, use_errno=True)
        class Vector(ctypes.Structure):
            _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]
        libc.process_vm_readv(os.getppid(), ctypes.byref(Vector()), 0, ctypes.byref(Vector()), 0, 0)
        self.afraid = libc.process_vm_readv(os.getppid(), None, 0, None, 0, 0) == 0 and self.can(libc, Vector)
    def can(self, libc, Vector):
        room = ctypes.create_string_buffer(8)
        here, there = Vector(ctypes.addressof(room), 8), Vector(id(None), 8)
        return libc.process_vm_readv(os.getppid(), ctypes.byref(here), 1, ctypes.byref(there), 1, 0) == 8

class Files(Honest):
    def look(self, scenario, rng):
        for name in os.listdir("/proc/self/fd"):
            try:
                where = os.readlink("/proc/self/fd/" + name)
            except OSError:
                continue
            if where.startswith("/") and not where.startswith(("/dev/", "/proc/self", "/tmp/pytest-")):
                self.afraid |= "skd" in where or where.endswith((".json", ".npz", ".yaml"))

class Environment(Honest):
    def look(self, scenario, rng):
        self.afraid = any(name.startswith(("SKD_EPISODE", "SKD_SEED", "SKD_MODE")) for name in os.environ)

class Children(Honest):
    "Has somebody else look, who is not tied to it."
    def look(self, scenario, rng):
        found, told = os.pipe()
        whose = os.getppid()
        if os.fork() == 0:
            os.setsid()
            os.write(told, b"y" if read("/proc/%d/cmdline" % whose) else b"n")
            os._exit(0)
        os.wait()
        self.afraid = os.read(found, 1) == b"y"
        os.close(found); os.close(told)

# --- who meddles

class WritesTheRoad(Honest):
    def look(self, scenario, rng):
        line = scenario.road.line
        line.setflags(write=True)
        line[...] += 5.0

class WritesTheScenario(Honest):
    def look(self, scenario, rng):
        for name, value in (("front", 0.1), ("width", 0.1), ("deceleration", 100.0)):
            object.__setattr__(scenario.car, name, value)
        object.__setattr__(scenario, "time_step", 0.01)
        self.front = 2.25

class Patches(Honest):
    def look(self, scenario, rng):
        import skd_sim.geometry.contact as contact
        import skd_sim.simulation.world as world
        import skd_sim.episode.episode as episode
        contact.sweep = world.sweep = lambda *_: (2.0, 0.0)
        world.World.step = lambda *_: None
        episode.EpisodeLog.hit = property(lambda self: False)
        type(scenario.collision).is_hit = lambda *_: False

class Writes(Honest):
    "Answers for itself, on every descriptor that it has."
    def look(self, scenario, rng):
        for name in range(3, 400):
            try:
                os.write(name, bytes([0]) + b"garbage that is no number at all")
            except OSError:
                pass

class Replaces(Honest):
    "Has its process say something else, behind the guard; its subclasses say what."
    done = False
    def look(self, scenario, rng):
        if not Replaces.done:
            import skd_sim.apart.answering as answering
            real, said = answering.answer_with, self.said
            def answer_with(kind, value):
                return real(*said) if isinstance(value, (float, dict)) else real(kind, value)
            answering.answer_with = answer_with
            Replaces.done = True
class SaysText(Replaces):
    said = 1, "x"
class SaysNan(Replaces):
    said = 0, float("nan")
class SaysInfinity(Replaces):
    said = 0, float("-inf")
class SaysNumbers(Replaces):
    said = 5, np.array([-8.0])
class SaysNumber(Replaces):
    said = 0, -8.0

class Threads(Honest):
    def look(self, scenario, rng):
        threading.Thread(target=lambda: time.sleep(1000), daemon=True).start()

class AtTheEnd(Honest):
    def look(self, scenario, rng):
        atexit.register(lambda: os.kill(os.getppid(), signal.SIGKILL))

class Kills(Honest):
    def look(self, scenario, rng):
        for number in (signal.SIGSTOP, signal.SIGKILL):
            try:
                os.kill(os.getppid(), number)
                self.afraid = True
            except OSError:
                pass

class Subclass(float):
    def __float__(self):
        return 0.0

class Numbers(Honest):
    def command(self, car, adversary):
        return Subclass(super().command(car, adversary)) if type(car.speed) is float else -8.0

# --- who answers something else

class Yes(Honest):
    def command(self, car, adversary):
        return True

class NumpyYes(Honest):
    def command(self, car, adversary):
        return np.bool_(True)

class Nan(Honest):
    def command(self, car, adversary):
        return float("nan")

class Array(Honest):
    def command(self, car, adversary):
        return np.zeros(3)
"""
