// Builds bundle/report.html, the page that gdibl fills with data: styles, program, worker and WebAssembly module in one file.
//
//   npm ci && node build.mjs           needs cargo with the target wasm32-unknown-unknown
//   node build.mjs --check             builds it anew and compares it with the one that is committed
//   node build.mjs --keep-module       takes the WebAssembly module that the committed one holds
//
// The page records checksums of its sources; a test of the program (tests/program/report.rs) compares them.
import { execFileSync } from 'node:child_process';
import { createHash } from 'node:crypto';
import { existsSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { crc32 } from 'node:zlib';
import { build } from 'esbuild';

const here = import.meta.dirname;
const repository = join( here, '../..' );
const bundle = join( here, 'bundle/report.html' );
const PAGE_SOURCES = [ 'integrations/report/src', 'integrations/report/build.mjs', 'integrations/report/package-lock.json', 'integrations/web/gdibl.mjs' ];
const MODULE_SOURCES = [ 'crates/runtime/src', 'crates/runtime/Cargo.toml', 'crates/runtime-c/src', 'crates/runtime-c/Cargo.toml' ];
const MOST_BYTES = 2 << 20;

// All files of a file or folder, by name.
function filesOf( path ) {

	const entries = path.match( /\.\w+$/ ) ? null : readdirSync( join( repository, path ), { withFileTypes: true } );
	if ( entries === null ) return [ path ];
	return entries.flatMap( ( entry ) => entry.isDirectory() ? filesOf( `${ path }/${ entry.name }` ) : [ `${ path }/${ entry.name }` ] ).sort();

}

// Of names and contents, so that nothing can change unseen.
export function checksum( sources ) {

	const files = sources.flatMap( filesOf ).sort();
	const parts = files.flatMap( ( file ) => [ Buffer.from( `${ file }\0` ), readFileSync( join( repository, file ) ), Buffer.from( '\0' ) ] );
	return crc32( Buffer.concat( parts ) ).toString( 16 ).padStart( 8, '0' );

}

function buildModule() {

	execFileSync( 'cargo', [ 'rustc', '-p', 'gdibl-runtime-c', '--lib', '--crate-type', 'cdylib', '--target', 'wasm32-unknown-unknown',
		'--profile', 'wasm', '--no-default-features', '--features', 'messages,fast,zstd' ],
	{ cwd: repository, stdio: 'inherit', env: { ...process.env, CARGO_PROFILE_WASM_OPT_LEVEL: '3' } } );
	const target = process.env.CARGO_TARGET_DIR ?? join( repository, 'target' );
	return readFileSync( join( target, 'wasm32-unknown-unknown/wasm/gdibl_runtime_c.wasm' ) ).toString( 'base64' );

}

const MODULE = /<script type="application\/octet-stream" id="module">([^<]*)<\/script>/;

async function buildPage( module, moduleChecksum ) {

	const shared = { bundle: true, minify: true, write: false, format: 'iife', target: 'es2022', charset: 'ascii', legalComments: 'eof', absWorkingDir: here,
		define: { 'import.meta.url': '"file:///"' } };
	const worker = await build( { ...shared, entryPoints: [ 'src/worker.js' ] } );
	const program = await build( { ...shared, entryPoints: [ 'src/main.js' ], define: { ...shared.define, WORKER: JSON.stringify( worker.outputFiles[ 0 ].text ) } } );
	const script = program.outputFiles[ 0 ].text;
	const styles = await build( { entryPoints: [ 'src/style.css' ], minify: true, write: false, absWorkingDir: here } );
	const parts = {
		STYLE: styles.outputFiles[ 0 ].text.trim(),
		SCRIPT: script,
		HASH: `sha256-${ createHash( 'sha256' ).update( script ).digest( 'base64' ) }`,
		MODULE: module,
		SOURCES: `page ${ checksum( PAGE_SOURCES ) }, module ${ moduleChecksum }`,
	};
	if ( /<\/script/i.test( script ) ) throw new Error( 'the program would end its own element' );
	// Functions: a `$` in a program means nothing.
	return readFileSync( join( here, 'src/page.html' ), 'utf8' ).replace( /%(\w+)%/g, ( _, name ) => parts[ name ] );

}

const committed = existsSync( bundle ) ? readFileSync( bundle, 'utf8' ) : '';
const keep = process.argv.includes( '--keep-module' );
const kept = committed.match( /module ([0-9a-f]{8})/ )?.[ 1 ];
const module = keep ? committed.match( MODULE )[ 1 ] : buildModule();
const page = await buildPage( module, keep ? kept : checksum( MODULE_SOURCES ) );
if ( page.length > MOST_BYTES ) throw new Error( `${ page.length } bytes, at most ${ MOST_BYTES }` );
if ( process.argv.includes( '--check' ) ) {

	// Compilers of other versions write other modules; the program is compared byte by byte.
	const without = ( text ) => text.replace( MODULE, '' );
	if ( without( page ) !== without( committed ) ) throw new Error( 'bundle/report.html is not what its sources build: node build.mjs' );
	const same = page === committed ? 'and the same module' : 'with a module of another compiler';
	console.log( `bundle/report.html is current, ${ same }` );

} else {

	mkdirSync( join( here, 'bundle' ), { recursive: true } );
	writeFileSync( bundle, page );
	console.log( `bundle/report.html: ${ page.length } bytes` );

}
