#!/bin/sh
# Makes the certificates of an arm's daemon and of its clients.
#
#   deploy/certificates.sh FOLDER daemon HOST...    the daemon's certificate, for all names and IPv4 addresses of its host
#   deploy/certificates.sh FOLDER client NAME...    a certificate for each operator or viewer
#
# The first run also makes the certificate authority. With FOLDER/ca/key.pem anybody can make certificates, so keep FOLDER
# off the robot. The script never overwrites a file: to renew a certificate, move its folder away and run the script again.
set -eu
umask 077

ca_days=3650
daemon_days=730
client_days=365

fail() {
  echo "certificates: $1" >&2
  exit 1
}

# sign COMMON-NAME DAYS EXTENSIONS [OPTION...]: makes $new with a key and a certificate, self-signed or signed by -CA.
sign() {
  subject=$1 days=$2 extensions=$3
  shift 3
  new=$(mktemp -d .new.XXXXXX)
  openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$new/key.pem"
  printf '%s\n' '[req]' 'distinguished_name = name' '[name]' '[made]' 'subjectKeyIdentifier = hash' \
    "$extensions" >"$new/made"
  openssl req -new -config "$new/made" -key "$new/key.pem" -subj "/CN=$subject" -out "$new/request"
  [ $# -gt 0 ] || set -- -signkey "$new/key.pem"
  openssl x509 -req -in "$new/request" "$@" -set_serial "0x$(openssl rand -hex 16)" -days "$days" -sha256 \
    -extfile "$new/made" -extensions made -out "$new/certificate.pem" 2>"$new/log" || fail "$(cat "$new/log")"
  rm "$new/request" "$new/made" "$new/log"
}

# keep NAME WHAT: moves the complete folder $new to its name.
keep() {
  mv "$new" "$1"
  echo "made $folder/$1: $2"
}

absent() {
  [ ! -e "$1" ] || fail "$folder/$1 exists; move it away to make a new one"
}

authority() {
  [ ! -e ca ] || return 0
  sign "hyperbit authority" "$ca_days" "basicConstraints = critical, CA:TRUE
keyUsage = critical, keyCertSign"
  keep ca "the authority, valid for $ca_days days; keep its key secret"
}

# issue NAME DAYS EXTENSIONS: makes $new with a certificate for NAME, signed by the authority, and the authority's certificate.
issue() {
  sign "$1" "$2" "basicConstraints = critical, CA:FALSE
keyUsage = critical, digitalSignature
$3" -CA ca/certificate.pem -CAkey ca/key.pem
  cp ca/certificate.pem "$new/ca.pem"
}

daemon() {
  names=DNS:localhost,IP:127.0.0.1
  for host; do
    case $host in
    *[!A-Za-z0-9.-]* | "" | -*) fail "'$host' is neither a host name nor an IPv4 address" ;;
    *[!0-9.]*) names=$names,DNS:$host ;;
    *) names=$names,IP:$host ;;
    esac
  done
  absent daemon
  authority
  issue daemon "$daemon_days" "extendedKeyUsage = serverAuth
subjectAltName = $names"
  echo "$1" >"$new/host"
  keep daemon "for $* and localhost, valid for $daemon_days days"
}

client() {
  case $1 in
  *[!A-Za-z0-9_-]* | "" | -* | ca | daemon) fail "'$1' is no name: letters, digits, _ and -, and neither ca nor daemon" ;;
  esac
  [ -e daemon/host ] || fail "$folder/daemon is missing: make the daemon's certificate first"
  absent "$1"
  issue "$1" "$client_days" "extendedKeyUsage = clientAuth"
  cat >"$new/zenoh.json5" <<TEXT
// For hyperbit's commands, option --zenoh. The certificates are in the same folder.
{
  mode: "client",
  connect: { endpoints: ["tls/$(cat daemon/host):7447"] },
  scouting: { multicast: { enabled: false }, gossip: { enabled: false } },
  transport: {
    shared_memory: { enabled: false },
    link: {
      tls: {
        root_ca_certificate: "ca.pem",
        enable_mtls: true,
        connect_certificate: "certificate.pem",
        connect_private_key: "key.pem",
        close_link_on_expiration: true,
      },
      tx: { lease: 1000, queue: { congestion_control: { block: { wait_before_close: 1000000 } } } },
    },
  },
}
TEXT
  keep "$1" "valid for $client_days days; its rights are those of $1 in the daemon's zenoh.json5"
}

[ $# -ge 3 ] || fail "usage: $0 FOLDER daemon HOST... | $0 FOLDER client NAME..."
command -v openssl >/dev/null || fail "openssl is missing: apt install openssl"
folder=$1 what=$2
shift 2
mkdir -p "$folder"
cd "$folder"
trap 'rm -rf .new.*' EXIT
case $what in
daemon) daemon "$@" ;;
client) for name; do client "$name"; done ;;
*) fail "'$what' is neither daemon nor client" ;;
esac
