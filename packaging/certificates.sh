#!/usr/bin/env bash
# Makes the lab's own certificate authority, and a certificate for one robot, for zenoh-tls.json5.
#   certificates.sh FOLDER NAME [ADDRESS]
# makes FOLDER/ca.pem and ca.key if they do not exist yet, and NAME.pem and NAME.key for the robot NAME (or NAME.local) at the IP
# address ADDRESS. A robot gets ca.pem, its NAME.pem as robot.pem and its NAME.key as robot.key. Keep ca.key off the robots.
set -euo pipefail
[ $# -ge 2 ] && [ $# -le 3 ] && [ "$2" != ca ] || { echo "usage: certificates.sh FOLDER NAME [ADDRESS]; no robot is called ca" >&2; exit 2; }
folder=$1 name=$2 address=${3:-127.0.0.1} days=3650
mkdir -p "$folder"
cd "$folder"
umask 077
# Key and certificate replace older ones together, or not at all.
new=$(mktemp -d ./new.XXXXXX)
trap 'rm -rf "$new"' EXIT
if [ ! -e ca.key ]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days "$days" -keyout "$new/ca.key" -out "$new/ca.pem" \
        -subj "/CN=csi5300 robots" -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign" 2>&1
    mv "$new/ca.pem" "$new/ca.key" .
fi
openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -keyout "$new/$name.key" -out "$new/csr" -subj "/CN=$name" 2>&1
openssl x509 -req -in "$new/csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days "$days" -out "$new/$name.pem" -extfile - 2>&1 <<END
basicConstraints=CA:FALSE
extendedKeyUsage=serverAuth,clientAuth
subjectAltName=DNS:$name,DNS:$name.local,IP:$address
END
mv "$new/$name.key" "$new/$name.pem" .
