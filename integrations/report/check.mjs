// Opens reports in a headless Chromium (software GL) and compares what they show with what gdibl says.
//
//   cargo build --release          (in the repository)
//   npm ci && node check.mjs       (here; pictures and volumes go into out/)
//
// CHROMIUM names the browser [/usr/bin/chromium], GDIBL the program [../../target/release/gdibl]. GDIBL_INPUTS names a folder
// with levels/godot/living_room.glb and hdr/aristea_wreck_puresky_1k.hdr; without, that room is skipped.
//
// 1. Pixels of white surfaces are those of `gdibl sample` at the same places: within 1 % of white, at 64 pixels.
// 2. Each switch changes the picture. A click on the worst node shows its number and figures.
// 3. No error in the console, no request but for the page itself.
// 4. Names with markup in them stay text. A damaged volume is an error, and no page.
// 5. Two bakes: cameras move together, and the difference is shown.
// 6. A million nodes: interactive within 5 s of CPU (the clock tells of other work, too), within 1 GB.
import { execFileSync, spawnSync } from 'node:child_process';
import { copyFileSync, existsSync, mkdirSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';
import { chromium } from 'playwright-core';
import { rooms } from './levels.mjs';

const here = import.meta.dirname;
const repository = join( here, '../..' );
const out = join( here, 'out' );
const gdibl = process.env.GDIBL ?? join( repository, 'target/release/gdibl' );
const inputs = process.env.GDIBL_INPUTS;
const PIXELS = 64;
const BOUND = 0.01;
const MOST_SECONDS = 5;
const MOST_BYTES = 1e9;
const LONGEST_TASK = 200;

let failed = 0;
const verdict = ( good, text ) => { console.log( `${ good ? 'ok      ' : 'FAILED  ' } ${ text }` ); failed += ! good; };
// Bakes what is not there yet.
const bake = ( name, ...parameters ) => existsSync( join( out, name ) ) || run( 'bake', ...parameters, '-o', name, '--quiet' );
const run = ( ...parameters ) => execFileSync( gdibl, parameters, { cwd: out, encoding: 'utf8', stdio: [ 'ignore', 'pipe', 'pipe' ], maxBuffer: 1 << 28 } );
const srgb = ( v ) => v <= 0.0031308 ? 12.92 * v : 1.055 * v ** ( 1 / 2.4 ) - 0.055;

// The page with its viewer, or the reason why there is none.
async function open( browser, file, viewport = { width: 1280, height: 900 }, options = {} ) {

	const page = await browser.newPage( { viewport, ...options } );
	page.said = [];
	page.asked = [];
	page.on( 'console', ( message ) => page.said.push( `${ message.type() }: ${ message.text() }` ) );
	page.on( 'pageerror', ( error ) => page.said.push( String( error ) ) );
	page.on( 'dialog', ( dialog ) => { page.said.push( `dialog: ${ dialog.message() }` ); dialog.dismiss(); } );
	page.on( 'request', ( request ) => page.asked.push( request.url() ) );
	await page.goto( pathToFileURL( join( out, file ) ).href );
	await page.evaluate( () => window.report.ready.then( () => {} ) );
	return page;

}

// All views have drawn what they show.
async function settle( page ) {

	await page.evaluate( () => window.report.viewer.shows );
	await page.waitForFunction( () => window.report.viewer.views.every( ( view ) => view.rested === view.moves ), null, { timeout: 60_000 } );
	await page.waitForTimeout( 100 );

}

const picture = ( page, view = 0 ) => page.evaluate( ( view ) => window.report.viewer.views[ view ].canvas.toDataURL(), view );

// Bytes of the view's pixels, from the top, and what the page says of some of them that show the level.
const pixelsOf = ( page ) => page.evaluate( ( count ) => {

	const [ view ] = window.report.viewer.views;
	const { width, height, clientWidth, clientHeight } = view.canvas;
	const copy = Object.assign( document.createElement( 'canvas' ), { width, height } ).getContext( '2d', { willReadFrequently: true } );
	copy.drawImage( view.canvas, 0, 0 );
	const found = [];
	// Steps of golden ratios: spread over the picture.
	for ( let k = 1; k < 4000 && found.length < count; k ++ ) {

		const [ x, y ] = [ Math.floor( k * 0.7548776662 % 1 * width ), Math.floor( k * 0.5698402910 % 1 * height ) ];
		const place = view.placeAt( ( x + 0.5 ) / width * clientWidth, ( y + 0.5 ) / height * clientHeight );
		if ( place ) found.push( { ...place, bytes: [ ...copy.getImageData( x, y, 1, 1 ).data ].slice( 0, 3 ) } );

	}

	return { found, gain: window.report.viewer.gain };

}, PIXELS );

async function checkPixels( page, name ) {

	await page.check( 'input[value=white]' );
	await page.uncheck( 'input[name=nodes]' );
	await settle( page );
	const { found, gain } = await pixelsOf( page );
	writeFileSync( join( out, 'places.csv' ), found.map( ( { position, normal } ) => [ ...position, ...normal ].join() ).join( '\n' ) );
	const rows = run( 'sample', `${ name }.gdibl`, '--at', 'places.csv' ).trim().split( '\n' ).slice( 1 ).map( ( row ) => row.split( ',' ).map( Number ) );
	const differences = rows.flatMap( ( row, k ) => row.slice( 6, 9 ).map( ( e, c ) => Math.abs( srgb( Math.min( 1, Math.max( 0, gain * e / Math.PI ) ) ) - found[ k ].bytes[ c ] / 255 ) ) );
	const largest = Math.max( ...differences );
	const distinct = new Set( found.map( ( { bytes } ) => bytes.join() ) ).size;
	verdict( rows.length === PIXELS && distinct > 8 && largest <= BOUND, `${ name }: ${ rows.length } pixels (${ distinct } colours) agree with gdibl sample to ${ ( 100 * largest ).toFixed( 2 ) } % of white` );
	await page.check( 'input[name=nodes]' );

}

async function checkSwitches( page, name ) {

	const seen = new Map();
	const note = async ( title ) => {

		await settle( page );
		const now = await picture( page );
		const twin = [ ...seen ].find( ( [ , other ] ) => other === now );
		if ( twin ) verdict( false, `${ name }: ${ title } shows the picture of ${ twin[ 0 ] }` );
		seen.set( title, now );

	};

	// From outside, where surfaces turn their backs, too.
	await page.check( 'input[value=lit]' );
	await page.evaluate( () => {

		const [ { opened: { header: { min, max } } } ] = window.report.viewer.shown;
		const size = Math.hypot( ...max.map( ( x, k ) => x - min[ k ] ) );
		window.report.viewer.views[ 0 ].look( [ 0.7 * size, 0.5 * size, 0.8 * size ], [ 0, 0, 0 ] );

	} );
	await note( 'light' );
	for ( const layer of await page.locator( '.layers input:enabled' ).all() ) {

		await layer.click();
		await note( `${ await layer.getAttribute( 'name' ) } switched` );
		await layer.click();

	}

	await page.locator( 'input[name=exposure]' ).fill( '1' );
	await note( 'a stop brighter' );
	await page.locator( 'input[name=exposure]' ).fill( '0' );
	await page.check( 'input[value=white]' );
	await note( 'irradiance' );
	// Nodes in walls are seen without the walls.
	await page.uncheck( 'input[name=level]' );
	for ( const mode of await page.locator( '.modes input:enabled' ).all() ) {

		const id = await mode.getAttribute( 'value' );
		if ( [ 'lit', 'white' ].includes( id ) ) continue;
		await mode.check();
		await note( id );

	}

	await page.check( 'input[name=level]' );
	verdict( seen.size > 8, `${ name }: ${ seen.size } switches, each with a picture of its own` );

}

async function checkClick( page, name ) {

	const report = JSON.parse( run( 'inspect', `${ name }.gdibl`, '--json' ) );
	const { figure, nodes: [ { node, value } ] } = report.worst_nodes[ 0 ];
	await page.locator( '.worst button', { hasText: `node ${ node }` } ).first().click();
	await settle( page );
	// The list has flown there: the node is in the middle.
	await page.evaluate( () => window.report.viewer.details.replaceChildren() );
	await page.uncheck( 'input[name=level]' );
	await settle( page );
	const box = await page.locator( 'canvas.view' ).first().boundingBox();
	await page.mouse.click( box.x + box.width / 2, box.y + box.height / 2 );
	await page.waitForSelector( '.details', { timeout: 10_000 } );
	const text = await page.locator( '.details' ).innerText();
	const number = `${ + ( 100 * value ).toPrecision( 2 ) } %`;
	verdict( text.startsWith( `Node ${ node }\n` ) && text.includes( number ), `${ name }: a click on the node of most ${ figure } says 'Node ${ node }' and ${ number }${ text.startsWith( `Node ${ node }\n` ) && text.includes( number ) ? '' : `: ${ text.replaceAll( '\n', ' ' ).slice( 0, 160 ) }` }` );
	await page.check( 'input[name=level]' );

}

function checkSilence( page, name ) {

	const others = page.asked.filter( ( url ) => ! url.startsWith( 'blob:' ) && ! url.startsWith( 'data:' ) ).slice( 1 );
	verdict( page.said.length === 0 && others.length === 0, `${ name }: nothing in the console, no request${ [ '', ...page.said, ...others ].join( '\n          ' ) }` );

}

async function pictures( browser, name ) {

	for ( const [ width, colorScheme ] of [ [ 1280, 'light' ], [ 400, 'dark' ] ] ) {

		const page = await open( browser, `${ name }.html`, { width, height: 900 }, { colorScheme } );
		await settle( page );
		const wide = await page.evaluate( () => document.documentElement.scrollWidth );
		verdict( wide <= width, `${ name }: a page of ${ width } pixels is not wider than that (${ wide })` );
		await page.screenshot( { path: join( out, `${ name }.${ width }.png` ), fullPage: true } );
		await page.close();

	}

}

async function checkVolume( browser, name, level ) {

	run( 'inspect', `${ name }.gdibl`, level, '-o', `${ name }.html` );
	const page = await open( browser, `${ name }.html` );
	await settle( page );
	await checkPixels( page, name );
	await checkSwitches( page, name );
	await checkClick( page, name );
	checkSilence( page, name );
	await page.close();
	await pictures( browser, name );

}

async function checkNames( browser ) {

	const name = `<img src=x onerror=alert(1)>"'&\u0001\u202e</script>`.replace( '/', '\u2215' );
	copyFileSync( join( out, 'rooms.glb' ), join( out, `${ name }.glb` ) );
	run( 'bake', `${ name }.glb`, '--counts', '3,3,3', '--samples', '64', '-o', `${ name }.gdibl`, '--quiet', '--report', 'names.html' );
	const page = await open( browser, 'names.html' );
	const shown = await page.evaluate( () => ( { images: document.images.length, scripts: [ ...document.scripts ].filter( ( script ) => ! script.type ).length, title: document.querySelector( 'h1' ).textContent } ) );
	const hidden = [ ...shown.title ].some( ( c ) => c < ' ' || c === '\u202e' );
	verdict( shown.images === 0 && shown.scripts === 1 && ! hidden && shown.title.includes( '<img src=x onerror=alert(1)>"\'&' ), `markup in a name stays text: ${ shown.title }` );
	checkSilence( page, 'a name with markup' );
	await page.close();

}

function checkDamage() {

	const whole = readFileSync( join( out, 'rooms.gdibl' ) );
	for ( const [ title, bytes ] of [ [ 'cut off', whole.subarray( 0, whole.length - 9 ) ], [ 'changed', Buffer.concat( [ whole.subarray( 0, 3000 ), Buffer.from( [ whole[ 3000 ] ^ 1 ] ), whole.subarray( 3001 ) ] ) ] ] ) {

		writeFileSync( join( out, 'damaged.gdibl' ), bytes );
		rmSync( join( out, 'damaged.html' ), { force: true } );
		const { status, stderr } = spawnSync( gdibl, [ 'inspect', 'damaged.gdibl', '-o', 'damaged.html' ], { cwd: out, encoding: 'utf8' } );
		verdict( status === 3 && stderr.includes( 'damaged.gdibl' ) && ! existsSync( join( out, 'damaged.html' ) ), `a volume that was ${ title }: exit ${ status }, and no page` );

	}

}

async function checkComparison( browser ) {

	bake( 'before.gdibl', 'rooms.glb', '--spacing', '0.4', '--tolerance', '0.05', '--samples', '256', '--seed', '1' );
	run( 'compare', 'rooms.gdibl', 'before.gdibl', '--level', 'rooms.glb', '-o', 'comparison.html' );
	const page = await open( browser, 'comparison.html' );
	await settle( page );
	await page.locator( 'canvas.view' ).first().press( 'w' );
	await settle( page );
	const [ a, b ] = await page.evaluate( () => window.report.viewer.views.map( ( { camera } ) => camera.position.toArray().join() ) );
	verdict( a === b, 'comparison: both cameras stand in one place after one has moved' );
	const lit = await picture( page );
	await page.check( 'input[value=difference]' );
	await settle( page );
	verdict( lit !== await picture( page ), 'comparison: the difference is shown' );
	await page.locator( '.worst button' ).first().click();
	await settle( page );
	checkSilence( page, 'comparison' );
	await page.screenshot( { path: join( out, 'comparison.1280.png' ), fullPage: true } );
	await page.close();

}

// Watches the main threads of pages; ends with the most CPU milliseconds that one task took.
async function watchTasks( browser ) {

	const client = await browser.newBrowserCDPSession();
	const events = [];
	client.on( 'Tracing.dataCollected', ( { value } ) => events.push( ...value ) );
	await client.send( 'Tracing.start', { traceConfig: { includedCategories: [ 'toplevel' ], excludedCategories: [ '*' ] } } );
	return async () => {

		const complete = new Promise( ( resolve ) => client.once( 'Tracing.tracingComplete', resolve ) );
		await client.send( 'Tracing.end' );
		await complete;
		const mains = new Set( events.filter( ( event ) => event.name === 'thread_name' && event.args.name === 'CrRendererMain' ).map( ( { pid, tid } ) => `${ pid } ${ tid }` ) );
		const own = events.filter( ( event ) => event.tdur !== undefined && mains.has( `${ event.pid } ${ event.tid }` ) );
		if ( own.length === 0 ) throw new Error( 'no task was traced' );
		return Math.max( ...own.map( ( { tdur } ) => tdur / 1000 ) );

	};

}

// Memory in bytes and CPU time in seconds of the process that draws the page: of those, the largest.
function renderer() {

	const all = readdirSync( '/proc' ).filter( ( id ) => /^\d+$/.test( id ) ).map( ( id ) => {

		try {

			if ( ! readFileSync( `/proc/${ id }/cmdline`, 'utf8' ).includes( '--type=renderer' ) ) return null;
			const ticks = readFileSync( `/proc/${ id }/stat`, 'utf8' ).split( ') ' )[ 1 ].split( ' ' ).slice( 11, 13 ).map( Number );
			return { bytes: 1024 * Number( readFileSync( `/proc/${ id }/status`, 'utf8' ).match( /VmRSS:\s+(\d+)/ )[ 1 ] ), seconds: ( ticks[ 0 ] + ticks[ 1 ] ) / 100 };

		} catch { return null; }

	} );
	return all.filter( Boolean ).reduce( ( a, b ) => a.bytes > b.bytes ? a : b );

}

async function checkMillion( browser ) {

	bake( 'million.gdibl', 'rooms.glb', '--bounds', '0,0,0,8,3,4', '--counts', '100,100,100', '--samples', '4', '--seen-places', '0' );
	run( 'inspect', 'million.gdibl', 'rooms.glb', '-o', 'million.html' );
	const tasks = await watchTasks( browser );
	const page = await open( browser, 'million.html' );
	const wall = await page.evaluate( () => window.report.seconds );
	const { seconds } = renderer();
	await settle( page );
	const { bytes } = renderer();
	const longest = await tasks();
	const first = await picture( page );
	await page.locator( 'canvas.view' ).press( 'w' );
	await settle( page );
	verdict( first !== await picture( page ), 'a million nodes: the camera moves' );
	verdict( seconds <= MOST_SECONDS, `a million nodes: interactive after ${ seconds.toFixed( 1 ) } s of CPU, ${ wall.toFixed( 1 ) } s on the clock (${ ( statSync( join( out, 'million.html' ) ).size / 1e6 ).toFixed( 1 ) } MB)` );
	verdict( bytes > 0 && bytes <= MOST_BYTES, `a million nodes: the page takes ${ ( bytes / 1e6 ).toFixed( 0 ) } MB` );
	verdict( longest <= LONGEST_TASK, `a million nodes: no task of the page's thread takes more than ${ longest.toFixed( 0 ) } ms of CPU` );
	checkSilence( page, 'a million nodes' );
	await page.close();

}

// `node check.mjs --keep` takes the volumes that lie there; `--only=million` does that part alone: box, rooms, living, damage, names,
// comparison, million.
const only = process.argv.find( ( word ) => word.startsWith( '--only=' ) )?.slice( 7 );
const wants = ( part ) => only === undefined || only === part;
if ( ! process.argv.includes( '--keep' ) ) rmSync( out, { recursive: true, force: true } );
mkdirSync( out, { recursive: true } );
writeFileSync( join( out, 'rooms.glb' ), rooms() );
const box = join( repository, 'assets/uffizi-box/uffizi-box.bake.toml' );
bake( 'box.gdibl', box, '--samples', '512' );
bake( 'rooms.gdibl', 'rooms.glb', '--spacing', '0.4', '--tolerance', '0.05', '--samples', '512' );
const browser = await chromium.launch( {
	executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
	args: [ '--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist' ],
} );
try {

	if ( wants( 'box' ) ) await checkVolume( browser, 'box', box );
	if ( wants( 'rooms' ) ) await checkVolume( browser, 'rooms', 'rooms.glb' );
	if ( inputs && wants( 'living' ) ) {

		const level = join( inputs, 'levels/godot/living_room.glb' );
		bake( 'living.gdibl', level, '--distant', join( inputs, 'hdr/aristea_wreck_puresky_1k.hdr' ), '--spacing', '0.3', '--tolerance', '0.05', '--samples', '512' );
		await checkVolume( browser, 'living', level );

	} else if ( ! inputs ) console.log( 'SKIPPED  the living room: GDIBL_INPUTS names no folder' );
	if ( wants( 'damage' ) ) checkDamage();
	if ( wants( 'names' ) ) await checkNames( browser );
	if ( wants( 'comparison' ) ) await checkComparison( browser );
	if ( wants( 'million' ) ) await checkMillion( browser );

} finally {

	await browser.close();

}

process.exit( failed ? 1 : 0 );
