"""Who can reach the workers of a sweep, and who cannot: SE-4 and SE-5."""

import datetime
import http.client
import os
import signal
import socket
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import contextmanager, nullcontext
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path

import psutil
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from distributed import LocalCluster, Security
from study.test_cluster import within
from study.toy import content, slow_toy, study, toy

from wobblesim.study.engines import cluster as module
from wobblesim.study.engines.cluster import Certificates, cluster
from wobblesim.study.errors import StoreError
from wobblesim.study.execute import sweep

ROOT = Path(__file__).parents[2]
LISTENS = "0A"

linux = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads /proc")


# --- SE-4: a sweep on this machine listens on loopback only -----------------------------------------------------------


def listeners(processes):
    """Addresses and ports that some processes listen on, as the kernel has them."""
    mine = {inode for pid in processes for inode in sockets(pid)}
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path("/proc/net", table).read_text().splitlines()[1:]:
            fields = line.split()
            address, port = fields[1].split(":")
            if fields[3] == LISTENS and fields[9] in mine:
                found.add((as_address(address), int(port, 16)))
    return found


def sockets(pid):
    """Inodes of a process's sockets."""
    links = []
    for handle in Path(f"/proc/{pid}/fd").iterdir():
        try:
            links.append(str(handle.readlink()))
        except OSError:
            continue
    return [link[8:-1] for link in links if link.startswith("socket:[")]


def as_address(written):
    """Words of 32 bits in the order of this machine, as /proc/net has them."""
    words = [bytes.fromhex(written[start : start + 8])[::-1] for start in range(0, len(written), 8)]
    return ip_address(b"".join(words))


def family():
    return [os.getpid(), *(child.pid for child in psutil.Process().children(recursive=True))]


@linux
@pytest.mark.parametrize("dashboard", [None, 0])
def test_a_sweep_on_workers_here_listens_on_loopback_only(tmp_path, dashboard):
    found, before = set(), listeners(family())

    def look(_):
        found.update(listeners(family()))

    with cluster(2, 1, dashboard=dashboard, simulate=slow_toy(0.02)) as engine:
        sweep(study(), tmp_path, engine=nullcontext(engine), progress=look)
    # Of the scheduler, two nannies and two workers, and a web server each of the scheduler and the workers.
    assert len(found - before) == 8
    assert {address for address, _ in found - before} == {IPv4Address("127.0.0.1")}


@linux
def test_a_listener_off_loopback_would_be_seen():
    with socket.create_server(("0.0.0.0", 0)) as four, socket.create_server(("::", 0), family=socket.AF_INET6) as six:
        expected = {(IPv4Address(0), four.getsockname()[1]), (IPv6Address(0), six.getsockname()[1])}
        assert expected <= listeners(family())


@linux
def test_no_other_user_of_this_machine_can_talk_to_the_workers():
    before = listeners(family())
    with cluster(1, 1):
        answers = [answer(port) for _, port in listeners(family()) - before]
    assert sorted(answers) == ["no certificate"] * 3 + ["no page"] * 2


def answer(port):
    """What somebody without a certificate gets from a port: not a page of the web, not a word of dask."""
    try:
        for page in ("status", "info/main/workers.html", "json/counts.json", "metrics", "proxy/22/127.0.0.1/"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"http://127.0.0.1:{port}/{page}", timeout=5)
        return "no page"
    except (OSError, http.client.HTTPException):  # it does not speak HTTP
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        with (
            socket.create_connection(("127.0.0.1", port), timeout=5) as plain,
            context.wrap_socket(plain) as secure,
            pytest.raises(ssl.SSLError, match="CERTIFICATE_REQUIRED"),
        ):
            secure.recv(1)
        return "no certificate"


# --- SE-5: a scheduler elsewhere -----------------------------------------------------------------------------------


class Authority:
    """A certificate authority that lives for an hour."""

    def __init__(self, folder, name):
        self.folder, self.name, self.key = folder, name, ec.generate_private_key(ec.SECP256R1())
        folder.mkdir()
        self.ca = folder / "ca.pem"
        self.ca.write_bytes(self._signed(f"{name} authority", self.key.public_key(), is_ca=True))

    def certificates(self, name):
        """A certificate for somebody, and its key."""
        key = ec.generate_private_key(ec.SECP256R1())
        cert, secret = self.folder / f"{name}.pem", self.folder / f"{name}.key"
        cert.write_bytes(self._signed(name, key.public_key(), is_ca=False))
        form = serialization.PrivateFormat.PKCS8
        secret.write_bytes(key.private_bytes(serialization.Encoding.PEM, form, serialization.NoEncryption()))
        return Certificates(self.ca, cert, secret)

    def _signed(self, name, public, is_ca):
        now = datetime.datetime.now(datetime.UTC)
        builder = x509.CertificateBuilder().public_key(public).serial_number(x509.random_serial_number())
        builder = builder.subject_name(called(name)).issuer_name(called(f"{self.name} authority"))
        builder = builder.not_valid_before(now - datetime.timedelta(minutes=5))
        builder = builder.not_valid_after(now + datetime.timedelta(hours=1))
        builder = builder.add_extension(x509.BasicConstraints(ca=is_ca, path_length=None), critical=True)
        return builder.sign(self.key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def called(name):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


@pytest.fixture(scope="module")
def authorities(tmp_path_factory):
    folder = tmp_path_factory.mktemp("authorities")
    return Authority(folder / "right", "right"), Authority(folder / "wrong", "wrong")


@pytest.fixture(scope="module")
def elsewhere(authorities):
    """A scheduler without workers, whose connections take certificates of the right authority."""
    mine = authorities[0].certificates("scheduler")
    security = Security(
        require_encryption=True,
        tls_ca_file=str(mine.ca),
        tls_scheduler_cert=str(mine.cert),
        tls_scheduler_key=str(mine.key),
        tls_client_cert=str(mine.cert),
        tls_client_key=str(mine.key),
    )
    with LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address="127.0.0.1:0", security=security) as made:
        yield made.scheduler_address


def test_certificates_of_the_right_authority_connect(elsewhere, authorities, monkeypatch):
    monkeypatch.setattr(module, "CONNECT_PATIENCE", 1.0)  # no worker will come
    with cluster(3, scheduler=elsewhere, certificates=authorities[0].certificates("client")) as engine:
        assert (engine.workers, engine.threads) == (3, 1)


def test_certificates_of_another_authority_do_not_connect(elsewhere, authorities):
    mine, theirs = authorities[1].certificates("client"), authorities[0]
    for certificates in (mine, Certificates(theirs.ca, mine.cert, mine.key)):  # we do not believe; we are not believed
        refused(elsewhere, "one side does not believe the other; all certificates .*", certificates=certificates)


def test_no_certificates_do_not_connect(elsewhere):
    refused(elsewhere, "tls:// needs certificates; give --tls-ca, --tls-cert and --tls-key", ValueError)
    refused(elsewhere.replace("tls", "tcp"), "it hangs up; write tls:// for .*")


def test_certificates_that_do_not_fit_are_refused(elsewhere, authorities):
    one, other = (authorities[0].certificates(name) for name in ("one", "other"))
    refused(elsewhere, "key values mismatch.*", ValueError, certificates=Certificates(one.ca, one.cert, other.key))
    missing = Certificates(one.ca, one.cert, one.key.with_name("missing"))
    refused(elsewhere, "cannot use the certificates: no such file or directory", ValueError, certificates=missing)
    refused("tcp://127.0.0.1:8786", "takes no certificates; write tls:// .*", ValueError, certificates=one)


def test_an_open_connection_to_another_machine_needs_a_word():
    # 192.0.2.0/24 is nobody's: RFC 5737
    refused(
        "tcp://192.0.2.7:8786", "is not encrypted: .*or give --insecure-tcp on a network that you trust", ValueError
    )


@pytest.mark.parametrize("address", ["", "host", "tls://host", "tls://:8786", "tls://host:99999", "http://host:80"])
def test_what_is_no_address_is_refused(address):
    refused(address, r"is not the address of a scheduler; write tls://host:port", ValueError)


@pytest.mark.nightly
def test_nobody_there_is_said_in_time(authorities):
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        address = f"tls://127.0.0.1:{deaf.getsockname()[1]}"
        refused(address, "nobody answers there within 10 s", certificates=authorities[0].certificates("client"))
    refused("tcp://192.0.2.7:8786", "nobody answers there within 10 s", insecure_tcp=True)


def refused(address, sentence, error=StoreError, **options):
    """Whether an address is refused, in bounded time and one line."""
    begun = time.monotonic()
    with pytest.raises(error, match=rf"^[^\n]*{sentence}$"), cluster(scheduler=address, **options):
        pass
    assert time.monotonic() - begun < 12  # measured 0.1 s, and 10.0 s where nobody answers


@pytest.mark.nightly
def test_a_sweep_on_a_cluster_with_certificates(tmp_path, authorities):
    """SE-5: a scheduler and two workers as `dask` starts them, with certificates; the rows are those of one process."""
    with sweeping(authorities[0], tmp_path) as scheduler:
        client = authorities[0].certificates("client")
        with cluster(2, scheduler=scheduler, certificates=client, simulate=toy) as engine:
            assert engine.threads == 2  # as the workers were started
            assert sweep(study(), tmp_path / "there", engine=nullcontext(engine)).done == 8
        refused(scheduler, "one side .*", certificates=authorities[1].certificates("client"))
    sweep(study(), tmp_path / "here", simulate=toy)
    assert content(tmp_path / "there") == content(tmp_path / "here")


@pytest.mark.nightly
def test_a_scheduler_that_dies_ends_the_sweep_with_a_sentence_and_nothing_is_lost(tmp_path, authorities):
    client, shot = authorities[0].certificates("client"), []
    with sweeping(authorities[0], tmp_path) as scheduler:

        def shoot(told):
            if told.kind == "epoch" and not shot:
                shot.append(time.monotonic())
                os.kill(listener(scheduler), signal.SIGKILL)

        with (
            pytest.raises(
                StoreError, match=r"^the scheduler is gone; what is stored is safe, and the same command goes"
            ),
            cluster(2, scheduler=scheduler, certificates=client, simulate=slow_toy(0.2)) as engine,
        ):
            sweep(study(), tmp_path / "there", engine=nullcontext(engine), progress=shoot)
    assert time.monotonic() - shot[0] < 45  # measured 10.3 s
    sweep(study(), tmp_path / "there", simulate=toy)
    sweep(study(), tmp_path / "here", simulate=toy)
    assert content(tmp_path / "there") == content(tmp_path / "here")


@pytest.mark.nightly
def test_workers_elsewhere_drop_the_jobs_of_a_sweep_that_is_gone(tmp_path, authorities):
    calls = tmp_path / "calls"
    script = f"""
import sys, time
from pathlib import Path
from study.toy import study, toy
from wobblesim.study.engines.cluster import Certificates, cluster
from wobblesim.study.execute import sweep

def task(*arguments, **options):
    with Path({str(calls)!r}).open("a") as file:
        file.write("called ")
    time.sleep(0.2)
    return toy(*arguments, **options)

engine = cluster(2, scheduler=sys.argv[1], certificates=Certificates(*sys.argv[2:5]), simulate=task)
sweep(study("learning.epochs=300"), sys.argv[5], engine=engine)
"""
    mine = authorities[0].certificates("client")
    with sweeping(authorities[0], tmp_path) as scheduler:
        process = subprocess.Popen(
            [sys.executable, "-c", script, scheduler, *map(str, vars(mine).values()), tmp_path / "out"],
            env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"},
        )
        assert within(60, calls.exists)
        process.kill()
        process.wait()
        time.sleep(3)
        some = calls.read_text()
        time.sleep(2)  # ten epochs
        assert calls.read_text() == some


def listener(scheduler):
    """The process that listens at an address."""
    port = int(scheduler.rpartition(":")[2])
    (found,) = {
        each.pid for each in psutil.net_connections("tcp") if each.laddr.port == port and each.status == "LISTEN"
    }
    return found


@contextmanager
def sweeping(authority, scratch):
    """The address of a scheduler with two workers of two threads."""
    port = free_port()
    address = f"tls://127.0.0.1:{port}"
    with (
        dask(authority, "scheduler", scratch, "--host", "127.0.0.1", "--port", port, "--no-dashboard"),
        dask(authority, "worker", scratch, address, "--nworkers", "2", "--nthreads", "2", "--no-dashboard"),
    ):
        yield address


@contextmanager
def dask(authority, role, scratch, *options):
    mine = authority.certificates(role)
    files = ["--tls-ca-file", mine.ca, "--tls-cert", mine.cert, "--tls-key", mine.key]
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", role, *map(str, [*files, *options])],
        cwd=scratch,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]
