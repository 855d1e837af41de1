# SPDX-License-Identifier: GPL-3.0-or-later
"""A cluster on one machine: hosts of whittled, a pair of PostgreSQL servers, Ceph's S3 gateway, nginx in front.

Each of them is in a network namespace of its own; a bridge in another one joins them, so nothing of it touches the
machine's own network.  The process that makes a Cluster moves into the namespace `client`.  Takes root, and the packages that
`make test-cluster` installs.
"""
import ctypes
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import threading
import time

ROOT = pathlib.Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests/integration"))
BUILD = pathlib.Path(os.environ.get("WHITTLE_BUILD", ROOT / "build/release")).resolve()
POSTGRES = pathlib.Path(os.environ.get("POSTGRES_BIN", "/usr/lib/postgresql/15/bin"))
FAKETIME = next(pathlib.Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)
AS_POSTGRES = ("setpriv", "--reuid", "postgres", "--regid", "postgres", "--clear-groups")
NUMBERS = {"client": 1, "lb": 2, "db1": 11, "db2": 12, "s3": 20}  # the last part of each address
PATIENCE_S = float(os.environ.get("WHITTLE_PATIENCE_S", "300"))  # how long a condition may take
NOBODY = "02:00:00:00:00:99"  # a link-layer address that no interface has


def run(*command, **options):
    """Its output; an error with all that it said when it fails or takes too long."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False,
                          timeout=options.pop("timeout", PATIENCE_S), **options)
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def wait_until(condition, what, seconds=PATIENCE_S):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        answer = condition()
        if answer:
            return answer
        time.sleep(0.05)
    raise AssertionError(f"{what} did not come in {seconds} s")


def descendants(pid):
    found = []
    for task in pathlib.Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            for child in map(int, task.read_text().split()):
                found += [child, *descendants(child)]
        except OSError:
            pass  # the thread has ended
    return found


def signal_tree(pid, number):
    """The process first, so that it makes no new ones, then all below it."""
    for each in [pid, *descendants(pid)] if number != signal.SIGKILL else [*stop_tree(pid)]:
        try:
            os.kill(each, number)
        except ProcessLookupError:
            pass


def stop_tree(pid):
    """Stops the process so that the list of those below it holds; the list."""
    try:
        os.kill(pid, signal.SIGSTOP)
    except ProcessLookupError:
        return []
    return [pid, *descendants(pid)]


def die_with_parent():
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


class Network:
    """Namespaces, each with one interface on a bridge; links that can be cut."""

    def __init__(self):
        self.prefix = f"whittle{os.getpid()}"
        self.numbers = {}
        self.home = os.open("/proc/self/ns/net", os.O_RDONLY)
        self.namespace("switch")
        run("ip", "-n", self.name("switch"), "link", "add", "bridge", "type", "bridge", "forward_delay", "0")
        run("ip", "-n", self.name("switch"), "link", "set", "bridge", "up")

    def name(self, node):
        return f"{self.prefix}-{node}"

    def namespace(self, node):
        run("ip", "netns", "add", self.name(node))
        run("ip", "-n", self.name(node), "link", "set", "lo", "up")

    def add(self, node, number):
        self.numbers[node] = number
        self.namespace(node)
        switch = self.name("switch")
        run("ip", "-n", switch, "link", "add", node, "type", "veth", "peer", "name", "eth0", "netns", self.name(node))
        run("ip", "-n", switch, "link", "set", node, "master", "bridge", "up")
        run("ip", "-n", self.name(node), "addr", "add", f"{self.address(node)}/24", "dev", "eth0")
        run("ip", "-n", self.name(node), "link", "set", "eth0", "up")

    def address(self, node):
        return f"10.77.0.{self.numbers[node]}"

    def inside(self, node):
        """The command that runs another one there, in its own place."""
        return ("ip", "netns", "exec", self.name(node))

    def enter(self, node):
        """Moves the calling thread; those that it makes follow."""
        with open(f"/run/netns/{self.name(node)}", encoding="ascii") as file:
            libc = ctypes.CDLL(None, use_errno=True)
            if libc.setns(file.fileno(), 0x40000000):  # CLONE_NEWNET
                raise OSError(ctypes.get_errno(), "setns")

    def cut(self, node):
        run("ip", "-n", self.name("switch"), "link", "set", node, "down")

    def join(self, node):
        run("ip", "-n", self.name("switch"), "link", "set", node, "up")

    def mute(self, node, other):
        """Nothing that one sends arrives at the other, silently; the way back is open."""
        run("ip", "-n", self.name(node), "neigh", "replace", self.address(other), "lladdr", NOBODY, "nud", "permanent",
            "dev", "eth0")

    def unmute(self, node, other):
        run("ip", "-n", self.name(node), "neigh", "del", self.address(other), "dev", "eth0")

    def close(self):
        ctypes.CDLL(None).setns(self.home, 0x40000000)
        os.close(self.home)
        for node in [*self.numbers, "switch"]:
            subprocess.run(["ip", "netns", "del", self.name(node)], capture_output=True, check=False)


class Process:
    """A program in a namespace, with a log; it can be killed, stopped, started again."""

    def __init__(self, command, log, **options):
        self.command, self.log, self.options = [str(c) for c in command], log, options
        self.process = None

    def start(self):
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                            preexec_fn=die_with_parent, **self.options)
        return self

    def lives(self):
        return self.process is not None and self.process.poll() is None

    def signal(self, number):
        if self.lives():
            signal_tree(self.process.pid, number)

    def kill(self):
        if self.lives():
            self.signal(signal.SIGKILL)
            self.process.wait()

    def stop(self):
        """Asks it to end, and waits."""
        if self.lives():
            self.signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                self.kill()


class DatabasePair:
    """A primary and a synchronous standby, and who watches over them: three questions without an answer end the
    primary for good (its processes are killed: what fences it), and then the standby, which has all that was
    acknowledged, is promoted.  The other one is made anew as its standby.  Commits wait for the standby from when it has
    caught up on; only then may it be promoted."""
    PORT = 5432
    SETTINGS = ("listen_addresses=*", "max_connections=200", "wal_level=replica", "hot_standby=on",
                "max_wal_senders=10", "wal_keep_size=256MB", "shared_buffers=32MB", "max_wal_size=256MB")

    def __init__(self, network, folder):
        self.network, self.folder = network, folder
        folder.mkdir(mode=0o755)
        shutil.chown(folder, "postgres")
        self.primary, self.standby = "db1", "db2"
        self.is_synchronous = False
        self.watches = threading.Lock()  # held by who promotes, or makes a standby
        self.promotions = []  # (when the primary was found gone, when the other was promoted), by time.monotonic()
        self.ends = threading.Event()
        self.nodes = {node: Process([*network.inside(node), *AS_POSTGRES, "--pdeathsig", "INT", POSTGRES / "postgres",
                                     "-D", self.data(node), "-k", self.socket(node), "-p", self.PORT,
                                     *(f for s in self.SETTINGS for f in ("-c", s))], folder / f"{node}.log",
                                    cwd=folder) for node in (self.primary, self.standby)}
        for node in self.nodes:
            self.socket(node).mkdir()
            shutil.chown(self.socket(node), "postgres")
        run(*AS_POSTGRES, POSTGRES / "initdb", "-D", self.data(self.primary), "-U", "whittle", "-A", "trust",
            "--no-sync", cwd=folder)
        with open(self.data(self.primary) / "pg_hba.conf", "a", encoding="ascii") as file:
            file.write("host all all 10.77.0.0/24 trust\nhost replication all 10.77.0.0/24 trust\n")
        self.nodes[self.primary].start()
        wait_until(lambda: self.answers(self.primary), "the primary")
        self.make_standby()
        self.watcher = threading.Thread(target=self.watch, daemon=True)
        self.watcher.start()

    def data(self, node):
        return self.folder / node

    def socket(self, node):
        return self.folder / f"{node}.sockets"

    @property
    def url(self):
        hosts = ",".join(f"{self.network.address(node)}:{self.PORT}" for node in sorted(self.nodes))
        return f"postgresql://whittle@{hosts}/postgres?target_session_attrs=read-write"

    def ask(self, node, text, seconds=20, by_socket=True):
        """Rows, as lines; by the socket, whatever the network is like."""
        host = self.socket(node) if by_socket else self.network.address(node)
        return run(POSTGRES / "psql", "-XAtq", "-h", host, "-p", self.PORT, "-U", "whittle", "-d", "postgres", "-c",
                   text, timeout=seconds, env={"PGCONNECT_TIMEOUT": "2", "PATH": os.environ["PATH"]}).splitlines()

    def answers(self, node, by_socket=False):
        """Whether it takes changes."""
        try:
            return self.ask(node, "SELECT pg_is_in_recovery()", 3, by_socket) == ["f"]
        except (RuntimeError, subprocess.TimeoutExpired):
            return False

    def set_synchronous(self, on):
        self.ask(self.primary, f"ALTER SYSTEM SET synchronous_standby_names = '{'*' if on else ''}'")
        self.ask(self.primary, "SELECT pg_reload_conf()")

    def is_followed(self, state="streaming"):
        try:
            return self.ask(self.primary, "SELECT state, sync_state FROM pg_stat_replication "
                                          "WHERE application_name = 'walreceiver'") == [f"streaming|{state}"]
        except (RuntimeError, subprocess.TimeoutExpired):
            return False

    def make_standby(self):
        """Anew, from the primary; whatever the standby had is gone."""
        self.nodes[self.standby].kill()
        shutil.rmtree(self.data(self.standby), ignore_errors=True)
        run(*self.network.inside(self.standby), *AS_POSTGRES, POSTGRES / "pg_basebackup", "-D",
            self.data(self.standby), "-R", "-X", "stream", "-c", "fast", "-U", "whittle", "-h",
            self.network.address(self.primary), "-p", self.PORT, cwd=self.folder)
        self.nodes[self.standby].start()
        wait_until(lambda: self.is_followed("async"), "the standby", 30)
        self.set_synchronous(True)
        wait_until(lambda: self.is_followed("sync"), "the synchronous standby", 30)
        self.is_synchronous = True

    def promote(self):
        found = time.monotonic()
        self.nodes[self.primary].kill()
        self.is_synchronous = False
        self.primary, self.standby = self.standby, self.primary
        self.lead()
        self.promotions.append((found, time.monotonic()))

    def lead(self):
        """Makes a standby of the one that has everything the primary that it is to be."""
        node = self.nodes[self.primary]
        if not node.lives():
            node.start()
        # What it has inherited would let its commits wait for a standby that isn't there.
        with open(self.data(self.primary) / "postgresql.auto.conf", "a", encoding="ascii") as file:
            file.write("synchronous_standby_names = ''\n")
        end = time.monotonic() + 60
        while not self.answers(self.primary, True) and time.monotonic() < end:
            subprocess.run([*AS_POSTGRES, POSTGRES / "pg_ctl", "promote", "-D", self.data(self.primary), "-w", "-t", "10"],
                           cwd=self.folder, capture_output=True, check=False)

    def orphan(self):
        """Promotes the standby, and nobody ends the primary, which goes on as if it were one: its commits wait for a
        standby that it doesn't have any more.  False where there is no standby that could be.  adopt ends it."""
        self.watches.acquire()  # pylint: disable=consider-using-with
        if not self.is_whole():
            self.watches.release()
            return False
        self.is_synchronous = False
        self.primary, self.standby = self.standby, self.primary
        self.lead()
        return True

    def adopt(self):
        """The one that was left is made a standby of the other."""
        self.watches.release()

    def watch(self):
        missed = 0
        while not self.ends.wait(0.5):
            with self.watches:
                missed = self.look(missed)

    def look(self, missed):
        """Does what there is to do; how often in a row the primary has had no answer."""
        try:
            missed = 0 if self.answers(self.primary) else missed + 1
            if missed >= 3 and self.is_synchronous:
                self.promote()
                missed = 0
            elif missed >= 3:  # the one that has everything is this one
                self.nodes[self.primary].kill()
                self.lead()
                missed = 0
            elif missed == 0 and not self.is_synchronous:
                self.make_standby()
            elif missed == 0 and not self.nodes[self.standby].lives():
                self.nodes[self.standby].start()
        except (RuntimeError, AssertionError, OSError, subprocess.TimeoutExpired) as error:
            with open(self.folder / "watch.log", "a", encoding="utf-8") as file:
                file.write(f"{error}\n")
        return missed

    def is_whole(self):
        return self.is_synchronous and self.is_followed("sync") and self.answers(self.primary)

    def close(self):
        self.ends.set()
        self.watcher.join(60)
        for node in (self.primary, self.standby):
            self.nodes[node].signal(signal.SIGCONT)
            self.nodes[node].kill()


class Store:
    """Ceph on memory, in one namespace, and a gateway of its own at an address that others reach."""
    PORT = 8000

    def __init__(self, network, folder):
        self.network = network
        folder.mkdir()
        self.ceph = subprocess.Popen(
            [*network.inside("s3"), ROOT / "tests/tools/with_s3.sh", "sh", "-c",
             "echo $CEPH_CONF; echo $AWS_ACCESS_KEY_ID; echo $AWS_SECRET_ACCESS_KEY; cat"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        conf, self.access, self.secret = (self.ceph.stdout.readline().strip() for _ in range(3))
        if not self.secret:
            raise RuntimeError("the store did not start")
        self.environment = dict(os.environ, CEPH_CONF=conf)
        self.gateway = Process([*network.inside("s3"), "radosgw", "-f", "-n", "client.rgw", "--rgw-frontends",
                                f"beast endpoint={network.address('s3')}:{self.PORT} tcp_nodelay=1"],
                               folder / "gateway.log", env=self.environment)
        self.gateway.start()
        wait_until(self.answers, "the gateway")

    def answers(self):
        return subprocess.run(["curl", "-s", "-o", os.devnull, "--max-time", "2",
                               f"http://{self.network.address('s3')}:{self.PORT}/"], check=False).returncode == 0

    @property
    def keys(self):
        return {"AWS_ACCESS_KEY_ID": self.access, "AWS_SECRET_ACCESS_KEY": self.secret}

    def url(self, prefix="cluster"):
        return f"s3://whittle/{prefix}?endpoint=http://{self.network.address('s3')}:{self.PORT}"

    def ceph_command(self, *words):
        return run(*self.network.inside("s3"), "ceph", "--connect-timeout", "20", *words, env=self.environment)

    def close(self):
        self.gateway.signal(signal.SIGCONT)
        self.gateway.kill()
        self.ceph.stdin.close()
        self.ceph.wait(60)


class Host:
    """A machine with whittled, which is started again when it ends, as systemd does.  Its data folder is a file system of
    its own, which can be filled, and its clock one that can be set."""
    PORT = 8080

    def __init__(self, cluster, name, flags, wrap=()):
        self.cluster, self.name = cluster, name
        self.folder = cluster.folder / name
        self.data, self.clock = self.folder / "data", self.folder / "clock"
        self.data.mkdir(parents=True)
        run("mount", "-t", "tmpfs", "-o", "size=256m,mode=0700", "tmpfs", self.data)
        self.set_clock(0)
        faked = {"LD_PRELOAD": str(FAKETIME), "FAKETIME_TIMESTAMP_FILE": str(self.clock), "FAKETIME_NO_CACHE": "1",
                 "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1"} if cluster.fakes_time else {}
        set_here = [f"{k}={v}" for k, v in faked.items()]
        address = cluster.network.address(name)
        self.process = Process(
            [*wrap, *cluster.network.inside(name), "env", *set_here, BUILD / "whittled", "--listen",
             f"{address}:{self.PORT}", "--admin-listen", f"{address}:{self.PORT + 1}", "--data", self.data, *flags],
            self.folder / "log", env=dict(os.environ, **cluster.store.keys))
        self.url = f"http://{address}:{self.PORT}"
        self.admin = f"http://{address}:{self.PORT + 1}"
        self.is_wanted = False

    def start(self):
        self.process.start()
        self.is_wanted = True

    def set_clock(self, seconds):
        self.clock.with_suffix(".new").write_text(f"{seconds:+d}\n", encoding="ascii")
        self.clock.with_suffix(".new").rename(self.clock)

    def fill_disk(self):
        try:
            with open(self.data / "ballast", "wb") as file:
                while True:
                    file.write(bytes(1 << 20))
                    file.flush()
        except OSError:
            pass

    def free_disk(self):
        (self.data / "ballast").unlink(missing_ok=True)

    def jobs(self):
        """Processes that compute."""
        found = []
        for pid in descendants(self.process.process.pid) if self.process.lives() else []:
            try:
                if os.readlink(f"/proc/{pid}/exe").endswith("/whittle"):
                    found.append(pid)
            except OSError:
                pass
        return found

    def answers(self):
        return subprocess.run(["curl", "-sf", "-o", os.devnull, "--max-time", "5", self.admin + "/readyz"],
                              check=False).returncode == 0

    def log_text(self):
        return (self.folder / "log").read_text(errors="replace")

    def close(self):
        self.is_wanted = False
        self.process.stop()
        subprocess.run(["umount", "-l", self.data], check=False)


NGINX = """worker_processes 1;
daemon off;
pid {folder}/pid;
error_log {folder}/error.log;
events {{ worker_connections 512; }}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    upstream whittled {{
{servers}
        keepalive 16;
    }}
    server {{
        listen {address}:80;
        client_max_body_size 2g;
        location / {{
            include {deploy}/nginx/whittled-proxy.conf;
            proxy_pass http://whittled;
        }}
    }}
}}
"""


class Cluster:
    """All of it.  Use as a context; `flags` are of every host."""

    def __init__(self, folder, hosts=3, flags=(), fakes_time=True, wrap=lambda name: ()):
        self.folder = pathlib.Path(folder)
        self.folder.chmod(0o755)
        self.fakes_time = fakes_time and FAKETIME is not None
        self.hosts, self.balancer, self.database, self.store, self.network = {}, None, None, None, None
        self.ends = threading.Event()
        try:
            self.set_up([f"host{i + 1}" for i in range(hosts)], flags, wrap)
        except BaseException:
            self.close()
            raise

    def set_up(self, names, flags, wrap):
        self.network = Network()
        for node, number in {**NUMBERS, **{name: 31 + i for i, name in enumerate(names)}}.items():
            self.network.add(node, number)
        self.network.enter("client")
        self.database = DatabasePair(self.network, self.folder / "postgres")
        self.store = Store(self.network, self.folder / "store")
        self.shared = ["--catalog", self.database.url, "--blobs", self.store.url()]
        run(BUILD / "whittled", "migrate", *self.shared[:2])
        for name in names:
            self.hosts[name] = Host(self, name, [*self.shared, "--insecure-open", "--allowed-hosts", "*", "--min-free", "16M", *flags],
                                    wrap(name))
            self.hosts[name].start()
        place = self.folder / "nginx"
        place.mkdir()
        servers = "\n".join(f"        server {self.network.address(n)}:{Host.PORT} max_fails=1 fail_timeout=2s;"
                            for n in names)
        (place / "nginx.conf").write_text(NGINX.format(folder=place, servers=servers, deploy=ROOT / "deploy",
                                                       address=self.network.address("lb")), encoding="ascii")
        self.balancer = Process([*self.network.inside("lb"), "nginx", "-c", place / "nginx.conf", "-p", place],
                                place / "log").start()
        self.url = f"http://{self.network.address('lb')}"
        threading.Thread(target=self.restart_hosts, daemon=True).start()
        for host in self.hosts.values():
            wait_until(host.answers, f"{host.name}: {host.log_text()[-2000:]}")
        wait_until(lambda: subprocess.run(["curl", "-sf", "-o", os.devnull, "--max-time", "5", self.url + "/v1/info"],
                                          check=False).returncode == 0, "the load balancer")

    def restart_hosts(self):
        while not self.ends.wait(0.3):
            for host in list(self.hosts.values()):
                if host.is_wanted and not host.process.lives() and not self.ends.is_set():
                    host.process.start()

    def is_whole(self):
        return (self.database.is_whole() and self.store.answers() and
                all(host.answers() for host in self.hosts.values()))

    def check(self):
        """What `whittled check` says of catalog and blobs: its status, its lines."""
        place = self.folder / "check"
        done = subprocess.run([BUILD / "whittled", "check", "--data", place, *self.shared], capture_output=True,
                              text=True, check=False, timeout=600, env=dict(os.environ, **self.store.keys))
        return done.returncode, (done.stdout + done.stderr).splitlines()

    def ran(self):
        """Which host has ended which jobs well: {job: [host, ...]}."""
        found = {}
        for host in self.hosts.values():
            for job in re.findall(r"job=(\S+) running -> successful", host.log_text()):
                found.setdefault(job, []).append(host.name)
        return found

    def close(self):
        self.ends.set()
        for host in self.hosts.values():
            host.is_wanted = False
        for host in self.hosts.values():
            host.close()
        if self.balancer:
            self.balancer.kill()
        for part in (self.store, self.database, self.network):
            if part:
                part.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
